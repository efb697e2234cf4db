//! What the camera driver promises when its camera misbehaves: each test's name is the promise.
#![allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    reason = "a test that cannot set up its scene has failed"
)]

use drivers::v4l2::node::FourCc;
use drivers::v4l2::{CameraDeviceConfig, CameraFormat, Capture, Opener, Setting, V4l2Error};
use drivers::{DeviceState, DeviceStatus};
use hal::{Error as _, ErrorKind, PixelFormat};
use hil::video::{Device, FakeCamera};
use rustix::io::Errno;

const MS: u64 = 1_000_000;
/// 50 pictures a second.
const INTERVAL: u64 = 20 * MS;

/// What was seen of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    sequence: u32,
    time_ns: u64,
    value: u8,
}

/// A driver, its camera, and the time.
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

    /// A camera that has delivered its first picture.
    fn working() -> Self {
        let mut bench = Self::new(Device::default(), |_| ());
        assert_eq!(bench.look().unwrap(), None, "to be opened");
        assert_eq!(bench.shoot(1).unwrap().value, 1);
        bench
    }

    /// Looks, and then does what has to be done.
    fn look(&mut self) -> Result<Option<Seen>, V4l2Error> {
        let seen = self.capture.with_newest(self.now_ns, |picture| {
            assert_eq!((picture.view.width(), picture.view.height()), (64, 48));
            Seen {
                sequence: picture.sequence,
                time_ns: picture.time_ns,
                value: picture.view.data()[0],
            }
        });
        if let Some(job) = self.capture.job(self.now_ns) {
            self.capture.done(job.run(&mut self.open, &self.config), self.now_ns);
        }
        seen
    }

    /// An interval later there is a picture, and somebody looks.
    fn shoot(&mut self, value: u8) -> Option<Seen> {
        self.now_ns += INTERVAL;
        assert!(self.camera.shoot(self.now_ns, value), "the camera had a buffer to fill");
        self.look().unwrap()
    }

    fn wait_ms(&mut self, ms: u64) -> Result<Option<Seen>, V4l2Error> {
        self.now_ns += ms * MS;
        self.look()
    }

    fn kind(&mut self) -> Option<ErrorKind> {
        self.look().err().map(|error| error.kind())
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
fn an_unplugged_camera_is_disconnected_at_once_and_delivers_again_when_it_is_back() {
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
    let seen = bench.shoot(7).unwrap();
    assert_eq!(
        (seen.value, bench.status().state, bench.status().reopened),
        (7, DeviceState::Working, 1)
    );
    assert_eq!(seen.sequence, 2, "numbers go on, although the camera counts from 0 again");
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
    // 100, 200, 400, 800 and 1600 ms, then every 2 s of the 60 s.
    assert_eq!(*opened.lock().unwrap(), 1 + 5 + (60_000 - 3_110) / 2_010);
    let error = bench.look().unwrap_err();
    assert!(error.to_string().contains("no camera at /dev/v4l/by-id/fake"), "{error}");
}

#[test]
fn a_silent_camera_is_a_timeout_after_two_intervals_and_never_blocks() {
    let mut bench = Bench::working();
    assert_eq!(bench.wait_ms(40), Ok(None), "two intervals");
    assert_eq!(bench.wait_ms(1).unwrap_err().kind(), ErrorKind::Timeout);
    assert_eq!(bench.status().state, DeviceState::Silent);
    assert_eq!(bench.shoot(2).unwrap().value, 2, "it listens on");
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
    assert_eq!(bench.shoot(3).unwrap().value, 3);
}

#[test]
fn a_stream_that_fails_is_restarted_without_closing_the_camera() {
    let mut bench = Bench::working();
    bench.camera.fail();
    assert_eq!(bench.kind(), Some(ErrorKind::Fault));
    assert_eq!(bench.shoot(4).unwrap().value, 4, "the next picture comes");
    assert_eq!((bench.status().reopened, bench.camera.opened()), (1, 1));
}

#[test]
fn a_stream_that_keeps_failing_is_not_restarted_in_a_storm() {
    let mut bench = Bench::working();
    for _ in 0..1000 {
        bench.camera.fail();
        _ = bench.wait_ms(10);
    }
    // 10 s: one restart, then openings after 100, 200, 400, ... ms.
    assert!((3..12).contains(&bench.camera.opened()), "{}", bench.camera.opened());
}

#[test]
fn the_newest_picture_is_handed_out_once_and_those_before_it_are_skipped() {
    let mut bench = Bench::working();
    for value in 10..13 {
        bench.now_ns += INTERVAL;
        assert!(bench.camera.shoot(bench.now_ns, value));
    }
    let seen = bench.look().unwrap().unwrap();
    assert_eq!((seen.value, seen.sequence, seen.time_ns), (12, 4, bench.now_ns));
    assert_eq!(bench.look().unwrap(), None, "once");
    assert_eq!((bench.capture.skipped(), bench.status().lost), (2, 0), "skipped is not lost");
}

#[test]
fn a_picture_older_than_its_budget_is_never_handed_out() {
    let mut bench = Bench::working();
    bench.now_ns += INTERVAL;
    assert!(bench.camera.shoot(bench.now_ns, 2));
    // As after a SIGSTOP of this process: the queue is full of what was.
    assert_eq!(bench.wait_ms(201), Ok(None));
    assert_eq!((bench.status().good, bench.status().bad), (1, 1));
    assert_eq!(bench.shoot(3).unwrap().value, 3, "the next one is fresh");
}

#[test]
fn pictures_that_the_camera_lost_are_counted_by_its_sequence_numbers() {
    let mut bench = Bench::working();
    bench.camera.lose(3);
    assert_eq!(bench.shoot(2).unwrap().sequence, 5, "the gap is seen");
    bench.camera.lose(u32::MAX - 5);
    bench.camera.lose(1);
    assert_eq!(bench.shoot(3).unwrap().sequence, 6, "a counter that goes back was restarted");
    assert_eq!(bench.status().lost, 3);
}

#[test]
fn pictures_that_found_no_buffer_because_nobody_looked_are_counted_as_lost() {
    let mut bench = Bench::working();
    for value in 0..10 {
        bench.now_ns += INTERVAL;
        bench.camera.shoot(bench.now_ns, value);
    }
    _ = bench.look();
    assert_eq!(bench.shoot(99).unwrap().value, 99);
    assert_eq!(bench.status().lost, 6, "4 of 10 found a buffer");
}

#[test]
fn a_damaged_or_cut_picture_is_dropped_and_a_camera_that_sends_only_such_is_silent() {
    let mut bench = Bench::working();
    for bytes in [vec![5; 64 * 48 * 2], vec![5; 100]] {
        bench.now_ns += INTERVAL;
        assert!(bench.camera.shoot_bytes(Some(bench.now_ns), &bytes, bytes.len() > 100));
        assert_eq!(bench.look().unwrap(), None);
    }
    assert_eq!(bench.status().bad, 2);
    bench.now_ns += INTERVAL;
    bench.camera.shoot_bytes(Some(bench.now_ns), &[], false);
    assert_eq!(bench.kind(), Some(ErrorKind::Timeout));
    assert_eq!(bench.shoot(6).unwrap().value, 6);
}

#[test]
fn a_jpeg_without_its_end_is_dropped() {
    let mut bench = Bench::new(Device::default(), |config| config.format = CameraFormat::Mjpeg);
    let mut shoot = |bytes: &[u8]| {
        bench.now_ns += INTERVAL;
        bench.camera.shoot_bytes(Some(bench.now_ns), bytes, false);
        let copy = |picture: &drivers::v4l2::Picture<'_>| {
            (picture.view.format(), picture.view.data().len())
        };
        let seen = bench.capture.with_newest(bench.now_ns, copy).unwrap();
        if let Some(job) = bench.capture.job(bench.now_ns) {
            bench.capture.done(job.run(&mut bench.open, &bench.config), bench.now_ns);
        }
        seen
    };
    assert_eq!(shoot(&[]), None, "to be opened");
    assert_eq!(shoot(&[0xff, 0xd8, 1, 2, 3, 0xff, 0xd9, 0, 0]), Some((PixelFormat::Mjpeg, 9)));
    assert_eq!(shoot(&[0xff, 0xd8, 1, 2, 3, 4]), None);
    assert_eq!(shoot(&[0; 64]), None);
    assert_eq!(bench.status().bad, 2);
}

#[test]
fn nv12_and_rgb_pictures_have_their_own_sizes() {
    for (format, bytes, pixels) in [
        (CameraFormat::Nv12, 64 * 48 * 3 / 2, PixelFormat::Nv12),
        (CameraFormat::Rgb24, 64 * 48 * 3, PixelFormat::Rgb8),
    ] {
        let mut bench = Bench::new(Device { multiplanar: true, ..Device::default() }, |config| {
            config.format = format
        });
        _ = bench.look();
        assert!(bench.camera.shoot(bench.now_ns, 1));
        let look = |picture: &drivers::v4l2::Picture<'_>| {
            (picture.view.format(), picture.view.data().len())
        };
        assert_eq!(bench.capture.with_newest(bench.now_ns, look).unwrap(), Some((pixels, bytes)));
    }
}

#[test]
fn time_stamps_of_another_clock_are_refused_with_the_way_out() {
    for stamp in [None, Some(1_800_000_000 * 1_000 * MS)] {
        let mut bench = Bench::working();
        bench.camera.shoot_bytes(stamp, &[0; 64 * 48 * 2], false);
        let error = bench.look().unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Unsupported);
        assert!(error.to_string().contains("CLOCK_MONOTONIC"), "{error}");
    }
}

#[test]
fn the_time_of_a_picture_is_the_middle_of_a_known_exposure() {
    let mut bench =
        Bench::new(Device::default(), |config| config.exposure_us = Some(Setting::Manual(10_000)));
    _ = bench.look();
    let start_ns = bench.now_ns;
    bench.camera.shoot(start_ns, 1);
    bench.now_ns += INTERVAL;
    assert_eq!(bench.look().unwrap().unwrap().time_ns, start_ns + 5 * MS);
}

#[test]
fn a_camera_that_stamps_late_is_believed_that_much_less() {
    let mut bench = Bench::new(Device::default(), |config| {
        (config.exposure_us, config.latency_ms) = (Some(Setting::Manual(10_000)), 30.0);
    });
    _ = bench.look();
    let stamp_ns = bench.now_ns;
    bench.camera.shoot(stamp_ns, 1);
    bench.now_ns += INTERVAL;
    assert_eq!(bench.look().unwrap().unwrap().time_ns, stamp_ns + 5 * MS - 30 * MS);
}

/// What the driver says of a camera that cannot do what is configured.
fn refusal(device: Device, configure: impl FnOnce(&mut CameraDeviceConfig)) -> String {
    let mut bench = Bench::new(device, configure);
    _ = bench.look();
    let error = bench.look().unwrap_err();
    assert_eq!(bench.status().state, DeviceState::Faulty, "{error}");
    error.to_string()
}

#[test]
fn a_camera_with_another_size_format_padding_or_rate_is_refused_with_words() {
    let size = Device { sizes: vec![(320, 240)], ..Device::default() };
    let text = refusal(size, |_| ());
    assert!(text.contains("makes 320x240 YUYV of 64x48 YUYV"), "{text}");
    let format = Device { formats: vec![FourCc::MJPEG, FourCc::NV12], ..Device::default() };
    let text = refusal(format, |_| ());
    assert!(text.contains("no YUYV; configure one of MJPG, NV12"), "{text}");
    let text = refusal(Device { row_padding: 32, ..Device::default() }, |_| ());
    assert!(text.contains("with rows of 160 bytes"), "{text}");
    let text = refusal(Device { fastest: 30, ..Device::default() }, |_| ());
    assert!(text.contains("30.00 pictures a second, 50.00 are configured"), "{text}");
}

#[test]
fn exposure_gain_and_white_balance_are_set_and_read_back() {
    let mut bench = Bench::new(Device::default(), |config| {
        config.exposure_us = Some(Setting::Manual(8_000));
        config.gain = Some(Setting::Manual(35));
        config.white_balance_k = Some(Setting::Auto);
    });
    _ = bench.look();
    let mut values = Vec::new();
    bench.camera.change(|device| values.extend(device.controls.iter().map(|(_, value)| *value)));
    assert_eq!(
        values,
        [1, 35, 4600, 1, 80],
        "white balance auto, gain, kelvin, exposure manual, 100 us"
    );
}

#[test]
fn a_control_that_cannot_be_so_is_refused_with_what_can_be() {
    let text = refusal(Device::default(), |config| config.gain = Some(Setting::Manual(101)));
    assert!(text.contains("gain cannot be 101: it goes from 0 to 100"), "{text}");
    let bare = || Device { controls: Vec::new(), ..Device::default() };
    let text = refusal(bare(), |config| config.exposure_us = Some(Setting::Manual(5_000)));
    assert!(text.contains("exposure cannot be 50: the camera has no such control"), "{text}");
    let text = refusal(bare(), |config| config.white_balance_k = Some(Setting::Auto));
    assert!(text.contains("configure a number"), "{text}");
}

#[test]
fn a_camera_that_another_program_uses_is_said_to_be_busy_and_taken_when_it_is_free() {
    let mut bench = Bench::new(Device::default(), |_| ());
    let mut other = bench.camera.open().unwrap();
    other.allocate(2).unwrap();
    _ = bench.look();
    assert_eq!(bench.kind(), Some(ErrorKind::Rejected));
    bench.camera.change(Device::close);
    drop(other);
    _ = bench.wait_ms(2_000);
    _ = bench.wait_ms(10);
    assert_eq!(bench.shoot(1).unwrap().value, 1);
}
