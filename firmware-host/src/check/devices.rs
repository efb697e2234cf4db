//! Opens each device as `run` does, for a few seconds. Nothing is armed: motors are told zero at most.

use std::path::Path;

use drivers::can::protocol::MotorStatus;
use drivers::can::{BaseConfig, CanError, DifferentialBase, Protocol, open_bus};
use drivers::hokuyo::{HokuyoConfig, HokuyoLidar, Port};
use drivers::v4l2::node::FourCc;
use drivers::v4l2::{self, CameraDeviceConfig, CameraFormat, V4l2Camera, V4l2Error};
use drivers::{DeviceState, DeviceStatus};
use hal::{Base, Camera, CameraModel, Clock, ErrorKind, Frame, LaserScan, Lidar};
use monotonic_clock::MonotonicClock;

use super::nearby;
use crate::config::Config;

/// A device that has not come to work by then is not well.
const PATIENCE_NS: u64 = 3_000_000_000;
/// One that works is watched for so long.
const WATCH_NS: u64 = 1_000_000_000;
/// From look to look: the pace of the safety loop.
const PACE_NS: u64 = 10_000_000;

/// How a device is.
pub struct Finding {
    /// Which.
    pub device: &'static str,
    /// Where the configuration says it is.
    pub path: String,
    /// Whether the robot could drive with it.
    pub is_well: bool,
    /// In a word.
    pub state: String,
    /// What it says it is.
    pub what: String,
    /// What is wrong and what to do; of one that is well, advice.
    pub to_do: Vec<String>,
}

impl Finding {
    fn well(device: &'static str, path: String, what: String) -> Self {
        Self {
            device,
            path,
            is_well: true,
            state: DeviceState::Working.to_string(),
            what,
            to_do: Vec::new(),
        }
    }

    fn unwell(
        device: &'static str,
        path: String,
        state: DeviceState,
        what: String,
        why: String,
    ) -> Self {
        Self { device, path, is_well: false, state: state.to_string(), what, to_do: vec![why] }
    }

    fn advise(mut self, advice: Option<String>) -> Self {
        self.to_do.extend(advice);
        self
    }
}

/// Looks at all of them at the same time; takes three seconds at most, or as long as a camera needs to be opened.
pub fn look(config: &Config) -> Vec<Finding> {
    let devices = &config.devices;
    std::thread::scope(|scope| {
        let eyes = scope.spawn(|| camera(&devices.camera));
        let scanner = scope.spawn(|| lidar(&devices.lidar));
        let wheels = base(&devices.base);
        let crashed = |device| {
            let why = "its driver has panicked; please report this".to_owned();
            Finding::unwell(device, String::new(), DeviceState::Faulty, String::new(), why)
        };
        vec![
            eyes.join().unwrap_or_else(|_| crashed("camera")),
            scanner.join().unwrap_or_else(|_| crashed("LiDAR")),
            wheels,
        ]
    })
}

/// Polls a device at the safety loop's pace: until it works and did so a second ago, or patience is over.
fn watch(mut poll: impl FnMut() -> DeviceStatus) -> Watched {
    let mut clock = MonotonicClock;
    let begin_ns = clock.now_ns();
    let mut working: Option<(u64, u64)> = None;
    loop {
        let status = poll();
        let now_ns = clock.now_ns();
        let works = status.state == DeviceState::Working;
        if works {
            working.get_or_insert((now_ns, status.good));
        }
        let (since_ns, good) = working.unwrap_or((now_ns, status.good));
        if works && now_ns - since_ns >= WATCH_NS || now_ns - begin_ns >= PATIENCE_NS {
            let rate_hz = (status.good - good) as f64 / ((now_ns - since_ns).max(1) as f64 * 1e-9);
            return Watched { status, rate_hz };
        }
        clock.sleep_until_ns(now_ns + PACE_NS);
    }
}

/// What a while with a device has shown.
struct Watched {
    status: DeviceStatus,
    rate_hz: f64,
}

fn camera(config: &CameraDeviceConfig) -> Finding {
    let path = || config.device.clone();
    let failed = |state, what: &str, error: &V4l2Error| {
        let lacks = matches!(error, V4l2Error::NotThere { .. } | V4l2Error::NotACamera { .. });
        let others = (lacks && config.socket().is_none()).then(|| nearby::CAMERAS.list());
        Finding::unwell("camera", path(), state, what.to_owned(), error.to_string()).advise(others)
    };
    let agreement = match v4l2::check(config) {
        Ok(agreement) => agreement,
        Err(error) => return failed(state_of(&error), "", &error),
    };
    let layout = agreement.layout;
    let offered = offer(&agreement.formats);
    let what = format!("{} {}x{}; it has {offered}", layout.format, layout.width, layout.height);
    // Only the size counts here: nothing is computed from these pictures.
    let model = CameraModel::pinhole(config.width as usize, config.height as usize, 1.0);
    let mut device = match V4l2Camera::new(config, model) {
        Ok(device) => device,
        Err(error) => return failed(state_of(&error), &what, &error),
    };
    let (mut frame, mut last_error) = (Frame::empty(), None);
    let watched = watch(|| {
        last_error = device.poll_frame(&mut frame).err();
        device.status()
    });
    match last_error {
        None if watched.status.state == DeviceState::Working => {
            let what = format!("{what}; {:.1} pictures a second", watched.rate_hz);
            let stable = nearby::CAMERAS
                .stable_name_of(Path::new(&config.device))
                .map(|name| renamed(&name));
            Finding::well("camera", path(), what).advise(stable)
        }
        Some(error) => failed(watched.status.state, &what, &error),
        None => {
            let why =
                "it has not given a picture yet; look again, and check the cable if this stays"
                    .to_owned();
            Finding::unwell("camera", path(), watched.status.state, what, why)
        }
    }
}

/// The formats that can be read, and how many others there are: some cameras have fifty.
fn offer(formats: &[FourCc]) -> String {
    let (ours, others): (Vec<FourCc>, Vec<_>) = formats
        .iter()
        .partition(|format| CameraFormat::ALL.iter().any(|ours| ours.names().contains(format)));
    let mut words: Vec<_> = ours.iter().map(ToString::to_string).collect();
    if !others.is_empty() {
        words.push(format!("{} that are not read here", others.len()));
    }
    words.join(", ")
}

fn lidar(config: &HokuyoConfig) -> Finding {
    let path = || config.port.to_string();
    let mut device = match HokuyoLidar::open(config.clone()) {
        Ok(device) => device,
        Err(error) => {
            return Finding::unwell(
                "LiDAR",
                path(),
                state_of(&error),
                String::new(),
                error.to_string(),
            );
        }
    };
    let monitor = device.monitor();
    let mut scan = LaserScan::empty(device.geometry());
    let watched = watch(|| {
        // What is wrong stands in the status and in the monitor's text.
        let _ = device.poll_scan(&mut scan);
        device.status()
    });
    let what = monitor.identity().map_or_else(String::new, |identity| {
        let known = |text: String| if text.is_empty() { "unknown".to_owned() } else { text };
        format!(
            "{}, serial {}, firmware {}",
            identity.model,
            known(identity.serial),
            known(identity.firmware)
        )
    });
    let serial = match &config.port {
        Port::Serial(path) => Some(path.as_path()),
        Port::Tcp { .. } => None,
    };
    if watched.status.state == DeviceState::Working {
        let hits = scan.ranges.iter().filter(|range| range.hit_m().is_some()).count();
        let beams = scan.ranges.len();
        let what = format!(
            "{what}; {:.1} scans a second, {hits} of {beams} beams meet something",
            watched.rate_hz
        );
        let stable =
            serial.and_then(|path| nearby::PORTS.stable_name_of(path)).map(|name| renamed(&name));
        let bad = watched.status.bad;
        let noise = (bad > 0)
            .then(|| format!("{bad} scans failed their checks meanwhile; check cable and ground"));
        return Finding::well("LiDAR", path(), what).advise(stable).advise(noise);
    }
    let starting =
        "its first good scans have not come yet; it may be starting: look again".to_owned();
    let why = monitor.problem().unwrap_or(starting);
    let others = serial.filter(|path| !path.exists()).map(|_| nearby::PORTS.list());
    Finding::unwell("LiDAR", path(), watched.status.state, what, why).advise(others)
}

fn base(config: &BaseConfig) -> Finding {
    let path = || config.bus.clone();
    let mut device = match DifferentialBase::new(open_bus(&config.bus), config) {
        Ok(device) => device,
        Err(error) => {
            return Finding::unwell(
                "base",
                path(),
                state_of(&error),
                String::new(),
                error.to_string(),
            );
        }
    };
    let watched = watch(|| {
        // Sets the motors up, reads their watchdogs back and holds zero; whether it got there stands in the status.
        let _ = device.poll_feedback();
        device.status()
    });
    let state = watched.status.state;
    let [left, right] = device.motors().map(motor);
    let protocol = match config.protocol {
        Protocol::Odrive => "ODrive",
        Protocol::Vesc => "VESC",
        Protocol::Cia402 => "CiA 402",
    };
    let (left_node, right_node) = (config.left_node, config.right_node);
    let what =
        format!("{protocol}: left (node {left_node}) {left}, right (node {right_node}) {right}");
    let why = match (device.check(), device.motors().into_iter().find_map(|motor| motor.problem)) {
        (Ok(()), None) if state == DeviceState::Working => {
            return Finding::well("base", path(), what);
        }
        (Err(CanError::Tripped(trip)), _) => trip.to_string(),
        (Err(error), _) => error.to_string(),
        (Ok(()), _) => device.explain(),
    };
    let state = if state == DeviceState::Working { DeviceState::Faulty } else { state };
    let interface =
        if config.bus.starts_with("unix:") { None } else { nearby::can_interface(&config.bus) };
    Finding::unwell("base", path(), state, what, why).advise(interface)
}

fn motor(status: &MotorStatus) -> String {
    match status.watchdog_ms {
        Some(ms) if status.feedback_ns > 0 => format!("watchdog {ms:.0} ms"),
        Some(ms) => format!("watchdog {ms:.0} ms, no feedback"),
        None => "watchdog not confirmed".to_owned(),
    }
}

fn renamed(name: &Path) -> String {
    format!("this path may be another device's after a restart; name it {} instead", name.display())
}

fn state_of(error: &impl hal::Error) -> DeviceState {
    match error.kind() {
        ErrorKind::Disconnected => DeviceState::Disconnected,
        ErrorKind::Timeout => DeviceState::Silent,
        _ => DeviceState::Faulty,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_with_many_formats_is_said_in_a_few_words() {
        let formats = [b"YUYV", b"UYVY", b"MJPG", b"Y16 "].map(FourCc::new);
        assert_eq!(offer(&formats), "YUYV, MJPG, 2 that are not read here");
        assert_eq!(offer(&formats[..1]), "YUYV");
    }
}
