//! Checks the V4L2 driver against vivid, the kernel's virtual video device. `v4l2-ctl` writes known
//! frames into vivid's output, which its camera returns; vivid's own controls inject the faults.

use std::error::Error;
use std::process::{Child, Command, Stdio};

use drivers::DeviceState;
use drivers::v4l2::node::controls;
use drivers::v4l2::{
    BorrowedFrame, CameraDeviceConfig, CameraFormat, Setting, V4l2Camera, V4l2Error,
    check as agree, open,
};
use hal::{CameraModel, Clock, Error as _, ErrorKind};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::check;

/// Device nodes of vivid.
#[derive(Debug, clap::Args)]
pub struct CameraProbe {
    /// Stable path of the camera that loops back /dev/video1.
    #[arg(long)]
    device: String,
    /// Device node of a multi-planar camera.
    #[arg(long)]
    planes: String,
}

const MS: u64 = 1_000_000;
const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
const SIZE: usize = 2 * 640 * 480;
/// Number of frames that the writer repeats.
const FRAMES: usize = 8;
/// Far longer than any step takes in an emulated machine.
const TIMEOUT_NS: u64 = 20_000 * MS;
const VIVID: &str = "/sys/bus/platform/drivers/vivid";

/// Runs all checks.
///
/// # Errors
/// Returns an error when the probe cannot be set up or the camera never delivers a frame.
pub fn run(probe: &CameraProbe) -> Result<(), Box<dyn Error>> {
    let frames = random_frames();
    let mut writer = write_frames(&frames)?;
    let mut bench = Bench::new(&probe.device)?;
    exact_frames(&mut bench, &frames)?;
    dropped_frames(&mut bench)?;
    silence(&mut bench)?;
    stream_failure(&mut bench)?;
    disconnection(&mut bench)?;
    exported_buffers(&mut bench);
    writer.kill()?;
    writer.wait()?;
    replug(&mut bench)?;
    drop(bench);
    settings(&probe.device);
    formats(&probe.device, "single-planar")?;
    formats(&probe.planes, "multi-planar")
}

/// The driver, and its configuration for a second handle to vivid's fault controls.
struct Bench {
    config: CameraDeviceConfig,
    camera: V4l2Camera,
    clock: MonotonicClock,
}

impl Bench {
    fn new(device: &str) -> Result<Self, V4l2Error> {
        Self::with(CameraDeviceConfig::new(device, WIDTH, HEIGHT, CameraFormat::Yuyv))
    }

    fn with(config: CameraDeviceConfig) -> Result<Self, V4l2Error> {
        let model = CameraModel::pinhole(config.width as usize, config.height as usize, 1.0);
        Ok(Self { camera: V4l2Camera::new(&config, model)?, config, clock: MonotonicClock })
    }

    /// Polls every 2 ms until `done`. Returns the elapsed time, milliseconds.
    fn until(
        &mut self,
        what: &str,
        mut done: impl FnMut(Result<Option<&BorrowedFrame<'_>>, V4l2Error>) -> bool,
    ) -> Result<u64, Box<dyn Error>> {
        let start_ns = monotonic_ns();
        loop {
            let found = match self.camera.with_newest(|frame| done(Ok(Some(frame)))) {
                Ok(Some(found)) => found,
                Ok(None) => done(Ok(None)),
                Err(error) => done(Err(error)),
            };
            let now_ns = monotonic_ns();
            if found {
                return Ok((now_ns - start_ns) / MS);
            }
            if now_ns - start_ns > TIMEOUT_NS {
                return Err(format!(
                    "timed out after {} s waiting for {what}; {:?}",
                    TIMEOUT_NS / 1_000 / MS,
                    self.camera.status()
                )
                .into());
            }
            self.clock.sleep_until_ns(now_ns + 2 * MS);
        }
    }

    fn until_frame(&mut self) -> Result<u64, Box<dyn Error>> {
        self.until("a frame", |polled| matches!(polled, Ok(Some(_))))
    }

    fn until_error(&mut self, kind: ErrorKind) -> Result<u64, Box<dyn Error>> {
        self.until(&format!("{kind:?}"), |polled| polled.is_err_and(|error| error.kind() == kind))
    }

    /// Sets one of vivid's controls by its name.
    fn vivid(&self, name: &str, value: i32) -> Result<(), Box<dyn Error>> {
        let mut node = open(&self.config)?;
        let control = controls(node.as_mut())?.into_iter().find(|control| control.name == name);
        node.set_control(control.ok_or_else(|| format!("vivid has no `{name}`"))?.id, value)?;
        Ok(())
    }
}

fn random_frames() -> Vec<Vec<u8>> {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    (0..FRAMES).map(|_| random_frame(&mut rng)).collect()
}

fn random_frame(rng: &mut Pcg64Mcg) -> Vec<u8> {
    let mut bytes = vec![0; SIZE];
    rng.fill_bytes(&mut bytes);
    bytes
}

fn write_frames(frames: &[Vec<u8>]) -> Result<Child, Box<dyn Error>> {
    std::fs::write("/tmp/frames.yuyv", frames.concat())?;
    let arguments =
        ["-d", "1", "--stream-out-mmap=4", "--stream-from=/tmp/frames.yuyv", "--stream-loop"];
    Ok(Command::new("v4l2-ctl")
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?)
}

fn is_known(frame: &BorrowedFrame<'_>, frames: &[Vec<u8>]) -> bool {
    frames.iter().any(|known| known[..] == *frame.view.data())
}

fn exact_frames(bench: &mut Bench, frames: &[Vec<u8>]) -> Result<(), Box<dyn Error>> {
    // Before the writer's first frame vivid shows its own test pattern.
    bench.until("the writer's first frame", |polled| {
        polled.is_ok_and(|frame| frame.is_some_and(|frame| is_known(frame, frames)))
    })?;
    let mut exact = 0;
    let mut count = 0;
    let mut last = (0, 0);
    let mut rising = true;
    let mut ages = Vec::new();
    let ms = bench.until("60 frames", |polled| {
        if let Ok(Some(frame)) = polled {
            ages.push(monotonic_ns() as i64 - frame.time_ns as i64);
            exact += u32::from(is_known(frame, frames));
            rising &= last < (frame.sequence, frame.time_ns);
            last = (frame.sequence, frame.time_ns);
            count += 1;
        }
        count == 60
    })?;
    let status = bench.camera.status();
    let figure = format!("{exact} of {count} in {ms} ms, {} lost", status.lost);
    check(
        "frames arrive as another program has written them, byte for byte",
        figure,
        exact == count,
    );
    check(
        "each frame is newer than the one before, by number and by time",
        format!("{count} frames"),
        rising,
    );
    ages.sort_unstable();
    let median = ages[ages.len() / 2] / 1_000;
    let worst = ages[ages.len() - 1] / 1_000;
    // Vivid stamps the end of a frame, and reports it up to one frame period before that end.
    let bound = i64::from(bench.config.max_age_ms) * 1_000;
    let figure = format!("median {median} us, worst {worst} us, youngest {} us", ages[0] / 1_000);
    check(
        "a frame is never older than its budget of 200 ms",
        figure,
        ages[0] > -40_000_000 && worst <= bound,
    );
    Ok(())
}

fn dropped_frames(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    let before = bench.camera.status();
    bench.vivid("Percentage of Dropped Buffers", 50)?;
    let mut seen = 0;
    bench.until("20 frames", |polled| {
        seen += u32::from(matches!(polled, Ok(Some(_))));
        seen == 20
    })?;
    bench.vivid("Percentage of Dropped Buffers", 0)?;
    let lost = bench.camera.status().lost - before.lost;
    check(
        "frames that the kernel drops are counted by their sequence numbers",
        format!("{lost} lost, {seen} seen"),
        lost >= 5,
    );
    Ok(())
}

fn silence(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    bench.until_frame()?;
    bench.vivid("Percentage of Dropped Buffers", 100)?;
    let ms = bench.until_error(ErrorKind::Timeout)?;
    let state = bench.camera.status().state;
    check(
        "a silent camera is a timeout after two intervals",
        format!("{ms} ms"),
        state == DeviceState::Silent && ms < 1_000,
    );
    bench.vivid("Percentage of Dropped Buffers", 0)?;
    let ms = bench.until_frame()?;
    check("a camera that was silent delivers again without intervention", format!("{ms} ms"), true);
    Ok(())
}

fn stream_failure(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    bench.until_frame()?;
    bench.vivid("Inject Fatal Streaming Error", 1)?;
    let noticed = bench.until_error(ErrorKind::Fault)?;
    let ms = bench.until_frame()?;
    let figure = format!("noticed in {noticed} ms, a frame {ms} ms later");
    check("a stream that fails permanently (EIO) is restarted", figure, ms < 5_000);
    Ok(())
}

fn disconnection(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    bench.until_frame()?;
    bench.vivid("Disconnect", 1)?;
    let noticed = bench.until_error(ErrorKind::Disconnected)?;
    let ms = bench.until_frame()?;
    let figure = format!("noticed in {noticed} ms, a frame {ms} ms later");
    check(
        "a camera that disconnects (ENODEV) is opened again by its stable path",
        figure,
        ms < 5_000,
    );
    Ok(())
}

fn exported_buffers(bench: &mut Bench) {
    let exported = bench.camera.export_buffers();
    let sizes: Vec<u64> = exported
        .iter()
        .flatten()
        .filter_map(|file| rustix::fs::seek(file, rustix::fs::SeekFrom::End(0)).ok())
        .collect();
    let passed = sizes.len() == 4 && sizes.iter().all(|size| *size >= SIZE as u64);
    let figure = exported
        .err()
        .map_or(format!("{} of {sizes:?} bytes", sizes.len()), |error| error.to_string());
    check("each buffer can be exported as a dma-buf", figure, passed);
}

fn replug(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    bench.until_frame()?;
    let before = bench.camera.status();
    std::fs::write(format!("{VIVID}/unbind"), "vivid.0")?;
    let noticed = bench.until_error(ErrorKind::Disconnected)?;
    let end_ns = monotonic_ns() + 1_000 * MS;
    let mut other = 0;
    bench.until("a second without a camera", |polled| {
        other += u32::from(polled.is_ok());
        monotonic_ns() > end_ns
    })?;
    let figure =
        format!("noticed in {noticed} ms, {other} polls did not report it in the next second");
    check(
        "an unplugged camera is reported as disconnected, and no frame is returned",
        figure,
        other == 0,
    );
    std::fs::write(format!("{VIVID}/bind"), "vivid.0")?;
    let ms = bench.until_frame()?;
    let status = bench.camera.status();
    let passed =
        ms < 5_000 && status.state == DeviceState::Working && status.reopened > before.reopened;
    check(
        "a camera that is plugged in again is found by its stable path",
        format!("a frame {ms} ms later"),
        passed,
    );
    Ok(())
}

fn settings(device: &str) {
    let mut config = CameraDeviceConfig::new(device, WIDTH, HEIGHT, CameraFormat::Yuyv);
    config.gain = Some(Setting::Manual(77));
    let held = read_back_gain(&config);
    let figure =
        held.as_ref().map_or_else(ToString::to_string, |held| format!("77 set, {held} read back"));
    check("a configured gain is held by the camera", figure, held.is_ok_and(|held| held == 77));
    config.gain = None;
    config.exposure_us = Some(Setting::Manual(5_000));
    refused(
        "a control that the camera does not have is refused with an explanation",
        &config,
        "no such control",
    );
    let odd = CameraDeviceConfig::new(device, 642, HEIGHT, CameraFormat::Yuyv);
    refused("a size that the camera does not have is refused with an explanation", &odd, "makes ");
    let none = CameraDeviceConfig::new("/dev/v4l/by-id/none", WIDTH, HEIGHT, CameraFormat::Yuyv);
    refused("a camera that is not connected is refused with an explanation", &none, "plug it in");
}

fn read_back_gain(config: &CameraDeviceConfig) -> Result<i32, Box<dyn Error>> {
    agree(config)?;
    let mut node = open(config)?;
    let gain = controls(node.as_mut())?.into_iter().find(|control| control.name == "Gain");
    Ok(node.control_value(gain.ok_or("vivid has no gain")?.id)?)
}

fn refused(claim: &str, config: &CameraDeviceConfig, expected: &str) {
    match agree(config) {
        Ok(agreement) => check(claim, format!("took {:?}", agreement.layout), false),
        Err(error) => {
            let error = error.to_string();
            let passed = error.contains(expected);
            check(claim, error.replace(&config.device, "it"), passed);
        }
    }
}

/// Every format that both vivid's webcam and the driver support, each until its fifth frame.
fn formats(device: &str, kind: &str) -> Result<(), Box<dyn Error>> {
    for (format, bytes) in [
        (CameraFormat::Yuyv, SIZE),
        (CameraFormat::Nv12, SIZE * 3 / 4),
        (CameraFormat::Rgb24, SIZE * 3 / 2),
    ] {
        let mut bench = Bench::with(CameraDeviceConfig::new(device, WIDTH, HEIGHT, format))?;
        let mut count = 0;
        let mut whole = true;
        let ms = bench.until("five frames", |polled| {
            if let Ok(Some(frame)) = polled {
                whole &= frame.view.data().len() == bytes
                    && frame.view.data().iter().any(|byte| *byte != 0);
                count += 1;
            }
            count == 5
        })?;
        let figure = format!("{count} frames in {ms} ms");
        check(&format!("a {kind} camera delivers {format:?}").to_lowercase(), figure, whole);
    }
    Ok(())
}
