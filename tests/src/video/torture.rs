//! Any order of events at a camera, for property tests and for the fuzzer.

use drivers::v4l2::{CameraDeviceConfig, CameraFormat, Capture, Opener};
use drivers::{DeviceState, DeviceStatus};
use hal::Error as _;

use super::device::Device;
use super::fake::FakeCamera;

/// Lets a driver and a camera go through the events that `bytes` name, and checks after each what must always hold.
///
/// # Panics
/// When it does not.
pub fn torture(bytes: &[u8]) {
    let camera = FakeCamera::new(Device { fastest: 1000, ..Device::default() });
    let config = CameraDeviceConfig::new("/dev/fake", 64, 48, CameraFormat::Yuyv);
    // Always good.
    let Ok(mut capture) = Capture::new(&config) else { return };
    let mut open: Opener = {
        let camera = camera.clone();
        Box::new(move || camera.open())
    };
    let (mut now_ns, mut last_sequence, mut last_time_ns) = (1_000_000_000_u64, 0, 0);
    let mut before = DeviceStatus::default();
    for byte in bytes {
        let (event, amount) = (byte >> 4, u64::from(byte & 15));
        let good = vec![*byte; 64 * 48 * 2];
        match event {
            0 => camera.unplug(),
            1 => camera.plug(),
            2 => camera.fail(),
            3 => camera.lose(amount as u32),
            4 => _ = camera.shoot_bytes(Some(now_ns), &good[..amount as usize * 100], false),
            5 => _ = camera.shoot_bytes(Some(now_ns), &good, true),
            6 => {
                _ = camera.shoot_bytes(
                    if amount == 0 { None } else { Some(now_ns << amount) },
                    &good,
                    false,
                );
            }
            7 => now_ns += amount * 100_000_000,
            8..12 => _ = camera.shoot_bytes(Some(now_ns), &good, false),
            _ => now_ns += amount * 3_000_000,
        }
        let seen = capture.with_newest(now_ns, |picture| {
            let first = picture.view.data()[0];
            assert!(picture.view.data().iter().all(|byte| *byte == first), "bytes of one picture");
            (picture.sequence, picture.time_ns)
        });
        if let Ok(Some((sequence, time_ns))) = seen {
            assert!(sequence > last_sequence, "numbers rise");
            assert!(
                time_ns >= last_time_ns || now_ns < last_time_ns,
                "a picture is handed out once"
            );
            assert!(now_ns.abs_diff(time_ns) <= 200_000_000, "no picture is older than its budget");
            (last_sequence, last_time_ns) = (sequence, time_ns);
        }
        if let Err(error) = seen {
            assert!(!error.to_string().is_empty());
            assert_ne!(capture.status().state, DeviceState::Working, "{:?}", error.kind());
        }
        if amount % 3 != 0
            && let Some(job) = capture.job(now_ns)
        {
            capture.done(job.run(&mut open, &config), now_ns);
        }
        let status = capture.status();
        assert!(
            status.good >= before.good && status.bad >= before.bad && status.lost >= before.lost
        );
        assert_eq!(camera.misuses(), 0, "the kernel would refuse a call of the driver's");
        before = status;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_driver_keeps_to_the_queues_rules_whatever_the_camera_does(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            super::torture(&bytes);
        }
    }
}
