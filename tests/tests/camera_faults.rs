//! Behaviour of the camera driver when its camera fails.
#![allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    reason = "a test that cannot set up its fixture has failed"
)]

use drivers::v4l2::node::FourCc;
use drivers::v4l2::{CameraDeviceConfig, CameraFormat, Capture, Opener, Setting, V4l2Error};
use drivers::{DeviceState, DeviceStatus};
use hal::{Error as _, ErrorKind, PixelFormat};
use hil::video::{Device, FakeCamera};
use rustix::io::Errno;

const MS: u64 = 1_000_000;
/// Frame interval at 50 frames per second.
const INTERVAL: u64 = 20 * MS;

/// Properties of a received frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    sequence: u32,
    time_ns: u64,
    value: u8,
}

/// A driver, its camera, and virtual time.
struct Bench {
    camera: FakeCamera,
    config: CameraDeviceConfig,
    capture: Capture,
    open: Opener,
    now_ns: u64,
}

impl Bench {
    fn new(device: Device, configure: impl FnOnce(&mut CameraDeviceConfig)) -> Self {
        let mut config = CameraDeviceConfig::new("/dev/v4l/by-id/fake", 64, 48, CameraFormat::Yuyv);
        config.fps = Some(50.0);
        configure(&mut config);
        let camera = FakeCamera::new(device);
        let opened = camera.clone();
        let open: Opener = Box::new(move || opened.open());
        Self { camera, capture: Capture::new(&config).unwrap(), config, open, now_ns: 1_000 * MS }
    }

    /// A driver whose camera has delivered its first frame.
    fn working() -> Self {
        let mut bench = Self::new(Device::default(), |_| ());
        assert_eq!(bench.poll().unwrap(), None, "not opened yet");
        assert_eq!(bench.deliver(1).unwrap().value, 1);
        bench
    }

    /// Polls, and then runs the driver's pending job.
    fn poll(&mut self) -> Result<Option<Seen>, V4l2Error> {
        let seen = self.capture.with_newest(self.now_ns, |frame| {
            assert_eq!((frame.view.width(), frame.view.height()), (64, 48));
            Seen { sequence: frame.sequence, time_ns: frame.time_ns, value: frame.view.data()[0] }
        });
        if let Some(job) = self.capture.take_job(self.now_ns) {
            self.capture.finish_job(job.run(&mut self.open, &self.config), self.now_ns);
        }
        seen
    }

    /// Advances by one interval, delivers a frame and polls.
    fn deliver(&mut self, value: u8) -> Option<Seen> {
        self.now_ns += INTERVAL;
        assert!(self.camera.deliver(self.now_ns, value), "the camera had a buffer to fill");
        self.poll().unwrap()
    }

    fn wait_ms(&mut self, ms: u64) -> Result<Option<Seen>, V4l2Error> {
        self.now_ns += ms * MS;
        self.poll()
    }

    fn kind(&mut self) -> Option<ErrorKind> {
        self.poll().err().map(|error| error.kind())
    }

    fn status(&self) -> DeviceStatus {
        self.capture.status()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert_eq!(self.camera.misuses(), 0, "the kernel would have refused a call");
        }
    }
}

#[test]
fn an_unplugged_camera_is_disconnected_at_once_and_delivers_again_after_replugging() {
    let mut bench = Bench::working();
    bench.camera.unplug();
    assert_eq!(bench.kind(), Some(ErrorKind::Disconnected));
    for _ in 0..50 {
        assert_eq!(bench.wait_ms(100).unwrap_err().kind(), ErrorKind::Disconnected);
        assert_eq!(bench.status().state, DeviceState::Disconnected);
    }
    bench.camera.plug();
    let begin_ns = bench.now_ns;
    while !bench.camera.is_streaming() {
        _ = bench.wait_ms(10);
    }
    assert!(bench.now_ns - begin_ns <= 2_010 * MS, "the longest time between two attempts");
    let seen = bench.deliver(7).unwrap();
    assert_eq!(
        (seen.value, bench.status().state, bench.status().reopened),
        (7, DeviceState::Working, 1)
    );
    assert_eq!(
        seen.sequence, 2,
        "sequence numbers continue, although the camera counts from 0 again"
    );
}

#[test]
fn attempts_to_open_an_absent_camera_are_at_most_two_seconds_apart_and_few() {
    let mut bench = Bench::new(Device::default(), |_| ());
    bench.camera.unplug();
    let opened = std::sync::Arc::new(std::sync::Mutex::new(0));
    let count = opened.clone();
    bench.open = Box::new(move || {
        *count.lock().unwrap() += 1;
        Err(Errno::NOENT)
    });
    for _ in 0..6000 {
        _ = bench.wait_ms(10);
    }
    // Back-off of 100, 200, 400, 800 and 1600 ms, then every 2 s of the 60 s.
    assert_eq!(*opened.lock().unwrap(), 1 + 5 + (60_000 - 3_110) / 2_010);
    let error = bench.poll().unwrap_err();
    assert!(error.to_string().contains("no camera at /dev/v4l/by-id/fake"), "{error}");
}

#[test]
fn a_silent_camera_is_a_timeout_after_two_intervals_and_never_blocks() {
    let mut bench = Bench::working();
    assert_eq!(bench.wait_ms(40), Ok(None), "two intervals");
    assert_eq!(bench.wait_ms(1).unwrap_err().kind(), ErrorKind::Timeout);
    assert_eq!(bench.status().state, DeviceState::Silent);
    assert_eq!(bench.deliver(2).unwrap().value, 2, "it keeps polling");
    assert_eq!(bench.status().state, DeviceState::Working);
    assert_eq!(bench.camera.opened(), 1);
}

#[test]
fn a_camera_that_stays_silent_is_restarted_after_a_second_and_opened_again_when_that_did_not_help()
{
    let mut bench = Bench::working();
    for _ in 0..11 {
        _ = bench.wait_ms(100);
    }
    assert_eq!((bench.status().reopened, bench.camera.opened()), (1, 1), "restarted");
    for _ in 0..15 {
        _ = bench.wait_ms(100);
    }
    assert_eq!(bench.camera.opened(), 2, "opened again");
    assert_eq!(bench.deliver(3).unwrap().value, 3);
}

#[test]
fn a_stream_that_fails_is_restarted_without_closing_the_camera() {
    let mut bench = Bench::working();
    bench.camera.fail();
    assert_eq!(bench.kind(), Some(ErrorKind::Fault));
    assert_eq!(bench.deliver(4).unwrap().value, 4, "the next frame arrives");
    assert_eq!((bench.status().reopened, bench.camera.opened()), (1, 1));
}

#[test]
fn a_stream_that_keeps_failing_is_restarted_at_a_bounded_rate() {
    let mut bench = Bench::working();
    for _ in 0..1000 {
        bench.camera.fail();
        _ = bench.wait_ms(10);
    }
    // In 10 s there is one restart, then there are attempts after 100, 200, 400, ... ms.
    assert!((3..12).contains(&bench.camera.opened()), "{}", bench.camera.opened());
}

#[test]
fn the_newest_frame_is_returned_once_and_those_before_it_are_skipped() {
    let mut bench = Bench::working();
    for value in 10..13 {
        bench.now_ns += INTERVAL;
        assert!(bench.camera.deliver(bench.now_ns, value));
    }
    let seen = bench.poll().unwrap().unwrap();
    assert_eq!((seen.value, seen.sequence, seen.time_ns), (12, 4, bench.now_ns));
    assert_eq!(bench.poll().unwrap(), None, "once");
    assert_eq!((bench.capture.skipped(), bench.status().lost), (2, 0), "skipped is not lost");
}

#[test]
fn a_frame_older_than_its_budget_is_never_returned() {
    let mut bench = Bench::working();
    bench.now_ns += INTERVAL;
    assert!(bench.camera.deliver(bench.now_ns, 2));
    // As after a SIGSTOP of this process, the queue is full of old frames.
    assert_eq!(bench.wait_ms(201), Ok(None));
    assert_eq!((bench.status().good, bench.status().bad), (1, 1));
    assert_eq!(bench.deliver(3).unwrap().value, 3, "the next frame is recent");
}

#[test]
fn frames_that_the_camera_lost_are_counted_by_its_sequence_numbers() {
    let mut bench = Bench::working();
    bench.camera.drop_frames(3);
    assert_eq!(bench.deliver(2).unwrap().sequence, 5, "the gap is seen");
    bench.camera.drop_frames(u32::MAX - 5);
    bench.camera.drop_frames(1);
    assert_eq!(bench.deliver(3).unwrap().sequence, 6, "a counter that goes back was restarted");
    assert_eq!(bench.status().lost, 3);
}

#[test]
fn frames_that_found_no_buffer_because_the_driver_did_not_poll_are_counted_as_lost() {
    let mut bench = Bench::working();
    for value in 0..10 {
        bench.now_ns += INTERVAL;
        bench.camera.deliver(bench.now_ns, value);
    }
    _ = bench.poll();
    assert_eq!(bench.deliver(99).unwrap().value, 99);
    assert_eq!(bench.status().lost, 6, "4 of 10 found a buffer");
}

#[test]
fn a_damaged_or_truncated_frame_is_dropped_and_a_camera_that_sends_only_such_is_silent() {
    let mut bench = Bench::working();
    for bytes in [vec![5; 64 * 48 * 2], vec![5; 100]] {
        bench.now_ns += INTERVAL;
        assert!(bench.camera.deliver_bytes(Some(bench.now_ns), &bytes, bytes.len() > 100));
        assert_eq!(bench.poll().unwrap(), None);
    }
    assert_eq!(bench.status().bad, 2);
    bench.now_ns += INTERVAL;
    bench.camera.deliver_bytes(Some(bench.now_ns), &[], false);
    assert_eq!(bench.kind(), Some(ErrorKind::Timeout));
    assert_eq!(bench.deliver(6).unwrap().value, 6);
}

#[test]
fn a_jpeg_without_its_end_is_dropped() {
    let mut bench = Bench::new(Device::default(), |config| config.format = CameraFormat::Mjpeg);
    assert_eq!(deliver_jpeg(&[], &mut bench), None, "not opened yet");
    assert_eq!(
        deliver_jpeg(&[0xff, 0xd8, 1, 2, 3, 0xff, 0xd9, 0, 0], &mut bench),
        Some((PixelFormat::Mjpeg, 9))
    );
    assert_eq!(deliver_jpeg(&[0xff, 0xd8, 1, 2, 3, 4], &mut bench), None);
    assert_eq!(deliver_jpeg(&[0; 64], &mut bench), None);
    assert_eq!(bench.status().bad, 2);
}

fn deliver_jpeg(bytes: &[u8], bench: &mut Bench) -> Option<(PixelFormat, usize)> {
    bench.now_ns += INTERVAL;
    bench.camera.deliver_bytes(Some(bench.now_ns), bytes, false);
    let seen = bench.capture.with_newest(bench.now_ns, format_and_length).unwrap();
    if let Some(job) = bench.capture.take_job(bench.now_ns) {
        bench.capture.finish_job(job.run(&mut bench.open, &bench.config), bench.now_ns);
    }
    seen
}

fn format_and_length(frame: &drivers::v4l2::BorrowedFrame<'_>) -> (PixelFormat, usize) {
    (frame.view.format(), frame.view.data().len())
}

#[test]
fn nv12_and_rgb_frames_have_their_own_sizes() {
    for (format, bytes, pixels) in [
        (CameraFormat::Nv12, 64 * 48 * 3 / 2, PixelFormat::Nv12),
        (CameraFormat::Rgb24, 64 * 48 * 3, PixelFormat::Rgb8),
    ] {
        let mut bench = Bench::new(Device { multiplanar: true, ..Device::default() }, |config| {
            config.format = format;
        });
        _ = bench.poll();
        assert!(bench.camera.deliver(bench.now_ns, 1));
        assert_eq!(
            bench.capture.with_newest(bench.now_ns, format_and_length).unwrap(),
            Some((pixels, bytes))
        );
    }
}

#[test]
fn timestamps_of_another_clock_are_refused_with_advice() {
    for stamp in [None, Some(1_800_000_000 * 1_000 * MS)] {
        let mut bench = Bench::working();
        bench.camera.deliver_bytes(stamp, &[0; 64 * 48 * 2], false);
        let error = bench.poll().unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(error.to_string().contains("CLOCK_MONOTONIC"), "{error}");
    }
}

#[test]
fn the_time_of_a_frame_is_the_middle_of_a_known_exposure() {
    let mut bench =
        Bench::new(Device::default(), |config| config.exposure_us = Some(Setting::Manual(10_000)));
    _ = bench.poll();
    let start_ns = bench.now_ns;
    bench.camera.deliver(start_ns, 1);
    bench.now_ns += INTERVAL;
    assert_eq!(bench.poll().unwrap().unwrap().time_ns, start_ns + 5 * MS);
}

#[test]
fn the_configured_latency_is_subtracted_from_the_timestamp() {
    let mut bench = Bench::new(Device::default(), |config| {
        config.exposure_us = Some(Setting::Manual(10_000));
        config.latency_ms = 30.0;
    });
    _ = bench.poll();
    let stamp_ns = bench.now_ns;
    bench.camera.deliver(stamp_ns, 1);
    bench.now_ns += INTERVAL;
    assert_eq!(bench.poll().unwrap().unwrap().time_ns, stamp_ns + 5 * MS - 30 * MS);
}

/// The error message for a camera that does not support the configuration.
fn refusal(device: Device, configure: impl FnOnce(&mut CameraDeviceConfig)) -> String {
    let mut bench = Bench::new(device, configure);
    _ = bench.poll();
    let error = bench.poll().unwrap_err();
    assert_eq!(bench.status().state, DeviceState::Faulty, "{error}");
    error.to_string()
}

#[test]
fn a_camera_with_another_size_format_padding_or_rate_is_refused_with_an_explanation() {
    let size = Device { sizes: vec![(320, 240)], ..Device::default() };
    let text = refusal(size, |_| ());
    assert!(text.contains("makes 320x240 YUYV of 64x48 YUYV"), "{text}");
    let format = Device { formats: vec![FourCc::MJPEG, FourCc::NV12], ..Device::default() };
    let text = refusal(format, |_| ());
    assert!(text.contains("no YUYV; configure one of MJPG, NV12"), "{text}");
    let text = refusal(Device { row_padding: 32, ..Device::default() }, |_| ());
    assert!(text.contains("with rows of 160 bytes"), "{text}");
    let text = refusal(Device { fastest: 30, ..Device::default() }, |_| ());
    assert!(text.contains("30.00 frames per second, 50.00 are configured"), "{text}");
}

#[test]
fn exposure_gain_and_white_balance_are_set_and_read_back() {
    let mut bench = Bench::new(Device::default(), |config| {
        config.exposure_us = Some(Setting::Manual(8_000));
        config.gain = Some(Setting::Manual(35));
        config.white_balance_k = Some(Setting::Auto);
    });
    _ = bench.poll();
    let mut values = Vec::new();
    bench.camera.change(|device| values.extend(device.controls.iter().map(|(_, value)| *value)));
    assert_eq!(
        values,
        [1, 35, 4600, 1, 80],
        "white balance auto, gain, kelvin, exposure manual, 100 us"
    );
}

#[test]
fn an_impossible_control_value_is_refused_with_the_allowed_range() {
    let text = refusal(Device::default(), |config| config.gain = Some(Setting::Manual(101)));
    assert!(text.contains("gain cannot be 101: it goes from 0 to 100"), "{text}");
    let text = refusal(device_without_controls(), |config| {
        config.exposure_us = Some(Setting::Manual(5_000));
    });
    assert!(text.contains("exposure cannot be 50: the camera has no such control"), "{text}");
    let text =
        refusal(device_without_controls(), |config| config.white_balance_k = Some(Setting::Auto));
    assert!(text.contains("configure a number"), "{text}");
}

fn device_without_controls() -> Device {
    Device { controls: Vec::new(), ..Device::default() }
}

#[test]
fn a_camera_in_use_by_another_program_is_reported_as_busy_and_opened_when_it_is_free() {
    let mut bench = Bench::new(Device::default(), |_| ());
    let mut other = bench.camera.open().unwrap();
    other.allocate(2).unwrap();
    _ = bench.poll();
    assert_eq!(bench.kind(), Some(ErrorKind::Rejected));
    bench.camera.change(Device::close);
    drop(other);
    _ = bench.wait_ms(2_000);
    _ = bench.wait_ms(10);
    assert_eq!(bench.deliver(1).unwrap().value, 1);
}
