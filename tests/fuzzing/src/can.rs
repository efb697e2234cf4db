use drivers::can::BusEvent;
use drivers::can::messages::{BaseCommand, BaseState, SafetyInput};
use drivers::can::protocol::cia402::{Cia402, Cia402Node};
use drivers::can::protocol::odrive::{Odrive, OdriveNode};
use drivers::can::protocol::vesc::{Vesc, VescNode};
use drivers::can::protocol::{MotorProtocol, MotorStage, Outbox};
use drivers::can::record::{decode, encode};

fn motors() -> [Box<dyn MotorProtocol>; 3] {
    [
        Box::new(Odrive::new(OdriveNode {
            node: 1,
            firmware: [0, 6, 10],
            enable_watchdog_endpoint: 195,
            watchdog_timeout_endpoint: 196,
            watchdog_ms: 100,
        })),
        Box::new(Vesc::new(VescNode {
            node: 1,
            host: 252,
            pole_pairs: 7.0,
            brake_a: 5.0,
            watchdog_ms: 100,
        })),
        Box::new(Cia402::new(Cia402Node {
            node: 1,
            host: 127,
            leads: true,
            watchdog_ms: 100,
            velocity_units: 4096.0,
            position_units: 4096.0,
        })),
    ]
}

/// Arbitrary records from a CAN bus as input of every motor protocol and of our own messages. The
/// input consists of 16-byte records of `struct can_frame`; each record is one frame and one tick
/// of the loop.
pub fn can(bytes: &[u8]) {
    let mut motors = motors();
    let mut out = Outbox::new();
    for (tick, record) in bytes.chunks(16).take(512).enumerate() {
        let now_ns = tick as u64 * 10_000_000;
        let Some(BusEvent::Frame(frame)) = decode(record) else { continue };
        assert_eq!(decode(&encode(&frame)), Some(BusEvent::Frame(frame)));
        let _ =
            (BaseCommand::decode(&frame), BaseState::decode(&frame), SafetyInput::decode(&frame));
        for motor in &mut motors {
            motor.receive(&frame, now_ns);
            let status = motor.status();
            assert!(status.velocity_radps.is_finite() && status.position_rad.is_finite());
            // Ready or Enabled means that the watchdog was read back, for any input.
            if matches!(status.stage, MotorStage::Ready | MotorStage::Enabled) {
                assert!(status.watchdog_ms.is_some_and(|ms| ms <= 100.0));
            }
            if status.stage == MotorStage::Ready {
                motor.enable();
            }
            motor.set_velocity(1.0);
            out.clear();
            motor.tick(now_ns, &mut out);
            assert!(out.len() <= 5);
        }
    }
}
