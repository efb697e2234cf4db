//! CAN codec: encoding of one command to a motor and decoding of its feedback, without a bus.

use std::hint::black_box;

use anyhow::{Context, Result};
use drivers::can::messages::BaseCommand;
use drivers::can::protocol::odrive::{Odrive, OdriveNode};
use drivers::can::protocol::{MotorProtocol, MotorStage, Outbox};
use drivers::can::record::{decode, encode};
use drivers::can::{BusEvent, CanFrame, CanId};
use hal::Twist2;

use crate::report::{Row, Timing, time};

const AREA: &str = "drivers";
/// Round trips per timed run: a single one is shorter than the clock's resolution.
const BATCH: u32 = 10_000;

/// Measures all rows of this module.
///
/// # Errors
/// When the motor cannot be enabled with the simulated answers.
pub fn measure() -> Result<Vec<Row>> {
    Ok(vec![motor()?, message()])
}

fn each(timing: Timing) -> Timing {
    let count = f64::from(BATCH);
    Timing { min: timing.min / count, median: timing.median / count, max: timing.max / count }
}

fn row(name: &str, timing: Timing, note: &str) -> Row {
    Row::seconds(AREA, name, each(timing)).goal(200e-9, 200e-9).note(note)
}

/// An ODrive axis that was enabled with the answers of a real one.
fn enabled() -> Result<Odrive> {
    let node = OdriveNode {
        node: 1,
        firmware: [0, 6, 10],
        enable_watchdog_endpoint: 195,
        watchdog_timeout_endpoint: 196,
        watchdog_ms: 100,
    };
    let mut motor = Odrive::new(node);
    let mut out = Outbox::new();
    let timeout = 0.1f32.to_le_bytes();
    let answers: [(u16, Vec<u8>); 4] = [
        (0x20, vec![2, 4, 4, 58, 0, 6, 10, 0]),
        (0x25, [&[0, 196, 0, 0][..], &timeout].concat()),
        (0x25, vec![0, 195, 0, 0, 1]),
        (0x29, vec![0; 8]),
    ];
    for round in 0..2 {
        for (id, data) in &answers {
            let frame = CanFrame::new(CanId::Standard(*id), data)
                .context("an answer is not a valid frame")?;
            motor.receive(&frame, 1);
        }
        if round == 0 {
            motor.enable();
        }
    }
    motor.tick(1, &mut out);
    motor.receive(&CanFrame::standard(0x21, [0, 0, 0, 0, 8, 0, 0, 0]), 1);
    anyhow::ensure!(
        motor.status().stage == MotorStage::Enabled,
        "the motor is not enabled: {:?}",
        motor.status()
    );
    Ok(motor)
}

fn motor() -> Result<Row> {
    let mut motor = enabled()?;
    let mut out = Outbox::new();
    let feedback = encode(&CanFrame::standard(0x29, [0, 0, 128, 63, 0, 0, 0, 64]));
    let mut now_ns = 2;
    let timing = time(200, || {
        for _ in 0..BATCH {
            now_ns += 1;
            out.clear();
            motor.set_velocity(black_box(1.5));
            motor.tick(now_ns, &mut out);
            for frame in &out {
                black_box(encode(frame));
            }
            if let Some(BusEvent::Frame(frame)) = decode(black_box(&feedback)) {
                motor.receive(&frame, now_ns);
            }
        }
        motor.status().velocity_radps
    });
    Ok(row(
        "CAN codec round trip",
        timing,
        "ODrive: velocity to the bytes of a frame, bytes of an encoder frame to feedback",
    ))
}

fn message() -> Row {
    let twist = Twist2 { linear_mps: 0.2, angular_radps: -0.5 };
    let mut counter = 0u8;
    let timing = time(200, || {
        let mut sum = 0.0;
        for _ in 0..BATCH {
            counter = counter.wrapping_add(1) & 0x0f;
            let command = BaseCommand {
                counter,
                armed: true,
                stop: false,
                plan_age_ms: 12,
                twist: black_box(twist),
            };
            let bytes = encode(&command.encode());
            if let Some(BusEvent::Frame(frame)) = decode(black_box(&bytes)) {
                sum += BaseCommand::decode(&frame).map_or(0.0, |command| command.twist.linear_mps);
            }
        }
        sum
    });
    row("own CAN message round trip", timing, "command with counter, plan age and checksum")
}
