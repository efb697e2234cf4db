//! Arbitrary sequences of camera events, for property tests and for the fuzzer.

use drivers::v4l2::{CameraDeviceConfig, CameraFormat, Capture, Opener};
use drivers::{DeviceState, DeviceStatus};
use hal::Error as _;

use super::device::Device;
use super::fake::FakeCamera;

/// Runs a driver and a camera through the sequence of events that `bytes` encode, and checks the
/// driver's invariants after each event.
///
/// # Panics
/// Panics when an invariant does not hold.
pub fn check_events(bytes: &[u8]) {
    let camera = FakeCamera::new(Device { fastest: 1000, ..Device::default() });
    let config = CameraDeviceConfig::new("/dev/fake", 64, 48, CameraFormat::Yuyv);
    // The configuration is always valid.
    let Ok(mut capture) = Capture::new(&config) else { return };
    let mut open: Opener = {
        let camera = camera.clone();
        Box::new(move || camera.open())
    };
    let mut now_ns = 1_000_000_000_u64;
    let mut last_sequence = 0;
    let mut last_time_ns = 0;
    let mut before = DeviceStatus::default();
    for byte in bytes {
        let event = byte >> 4;
        let amount = u64::from(byte & 15);
        let good = vec![*byte; 64 * 48 * 2];
        match event {
            0 => camera.unplug(),
            1 => camera.plug(),
            2 => camera.fail(),
            3 => camera.drop_frames(amount as u32),
            4 => _ = camera.deliver_bytes(Some(now_ns), &good[..amount as usize * 100], false),
            5 => _ = camera.deliver_bytes(Some(now_ns), &good, true),
            6 => {
                _ = camera.deliver_bytes(
                    if amount == 0 { None } else { Some(now_ns << amount) },
                    &good,
                    false,
                );
            }
            7 => now_ns += amount * 100_000_000,
            8..12 => _ = camera.deliver_bytes(Some(now_ns), &good, false),
            _ => now_ns += amount * 3_000_000,
        }
        let seen = capture.with_newest(now_ns, |frame| {
            let first = frame.view.data()[0];
            assert!(
                frame.view.data().iter().all(|byte| *byte == first),
                "all bytes belong to the same frame"
            );
            (frame.sequence, frame.time_ns)
        });
        if let Ok(Some((sequence, time_ns))) = seen {
            assert!(sequence > last_sequence, "sequence numbers increase");
            assert!(time_ns >= last_time_ns || now_ns < last_time_ns, "a frame is returned once");
            assert!(now_ns.abs_diff(time_ns) <= 200_000_000, "no frame is older than its budget");
            last_sequence = sequence;
            last_time_ns = time_ns;
        }
        if let Err(error) = seen {
            assert!(!error.to_string().is_empty());
            assert_ne!(capture.status().state, DeviceState::Working, "{:?}", error.kind());
        }
        if amount % 3 != 0
            && let Some(job) = capture.take_job(now_ns)
        {
            capture.finish_job(job.run(&mut open, &config), now_ns);
        }
        let status = capture.status();
        assert!(
            status.good >= before.good && status.bad >= before.bad && status.lost >= before.lost
        );
        assert_eq!(camera.misuses(), 0, "the driver made a call that the kernel would refuse");
        before = status;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_driver_follows_the_queues_rules_for_any_camera_events(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            super::check_events(&bytes);
        }
    }
}
