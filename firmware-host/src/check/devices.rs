//! Opens each device as `run` does, for a few seconds. Nothing is armed: motors receive at most a velocity of zero.

use std::path::Path;

use drivers::can::protocol::MotorStatus;
use drivers::can::{BaseConfig, CanError, DifferentialBase, open_bus};
use drivers::lidar::{AnyLidar, LidarConfig};
use drivers::stop_line::{StopLine, StopLineConfig};
use drivers::v4l2::node::FourCc;
use drivers::v4l2::{self, CameraDeviceConfig, CameraFormat, V4l2Camera, V4l2Error};
use drivers::{DeviceState, DeviceStatus, Port};
use hal::{Base, Camera, CameraModel, Clock, ErrorKind, Frame, LaserScan, Lidar};
use monotonic_clock::MonotonicClock;

use super::{imu, nearby};
use crate::config::Config;

/// A device that does not work after this time is not usable.
const TIMEOUT_NS: u64 = 3_000_000_000;
/// The rate of a working device is measured for this long.
const MEASURE_NS: u64 = 1_000_000_000;
/// Time between two polls: the period of the safety loop.
const POLL_NS: u64 = 10_000_000;

const STOP_LINE: &str = "emergency stop";

/// The result of testing one device.
pub struct Finding {
    pub device: &'static str,
    /// Its path or address in the configuration.
    pub path: String,
    /// Whether the robot could drive with it.
    pub is_usable: bool,
    pub state: String,
    /// What the device reports about itself, and what was measured.
    pub details: String,
    /// What is wrong and how to correct it; for a usable device, suggestions.
    pub advice: Vec<String>,
}

impl Finding {
    pub fn usable(device: &'static str, path: String, details: String) -> Self {
        Self {
            device,
            path,
            is_usable: true,
            state: DeviceState::Working.to_string(),
            details,
            advice: Vec::new(),
        }
    }

    pub fn unusable(
        device: &'static str,
        path: String,
        state: DeviceState,
        details: String,
        problem: String,
    ) -> Self {
        Self {
            device,
            path,
            is_usable: false,
            state: state.to_string(),
            details,
            advice: vec![problem],
        }
    }

    pub fn advise(mut self, advice: Option<String>) -> Self {
        self.advice.extend(advice);
        self
    }
}

/// Tests all devices at the same time. This takes at most three seconds, or as long as a camera needs to open.
pub fn test_all(config: &Config) -> Vec<Finding> {
    let devices = &config.devices;
    std::thread::scope(|scope| {
        let camera = scope.spawn(|| test_camera(&devices.camera));
        let lidar = scope.spawn(|| test_lidar(&devices.lidar));
        let imu = scope.spawn(|| imu::test(&devices.imu));
        let base = test_base(&devices.base);
        let mut findings = vec![
            camera.join().unwrap_or_else(|_| panicked("camera")),
            lidar.join().unwrap_or_else(|_| panicked("LiDAR")),
            base,
        ];
        findings.extend(imu.join().unwrap_or_else(|_| Some(panicked("IMU"))));
        findings.extend(test_stop_line(&devices.emergency_stop));
        findings
    })
}

fn panicked(device: &'static str) -> Finding {
    let problem = "its driver has panicked; please report this".to_owned();
    Finding::unusable(device, String::new(), DeviceState::Faulty, String::new(), problem)
}

/// Polls a device at the rate of the safety loop, until it has worked for a second or the time is over.
pub fn measure(mut poll: impl FnMut() -> DeviceStatus) -> Measured {
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
        if works && now_ns - since_ns >= MEASURE_NS || now_ns - begin_ns >= TIMEOUT_NS {
            let rate_hz = (status.good - good) as f64 / ((now_ns - since_ns).max(1) as f64 * 1e-9);
            return Measured { status, rate_hz };
        }
        clock.sleep_until_ns(now_ns + POLL_NS);
    }
}

pub struct Measured {
    pub status: DeviceStatus,
    pub rate_hz: f64,
}

fn test_camera(config: &CameraDeviceConfig) -> Finding {
    let agreement = match v4l2::check(config) {
        Ok(agreement) => agreement,
        Err(error) => return camera_failed(config, state_of(&error), "", &error),
    };
    let layout = agreement.layout;
    let offered = list_formats(&agreement.formats);
    let details =
        format!("{} {}x{}; formats: {offered}", layout.format, layout.width, layout.height);
    // Only the size matters, because nothing is computed from these images.
    let model = CameraModel::pinhole(config.width as usize, config.height as usize, 1.0);
    let mut device = match V4l2Camera::new(config, model) {
        Ok(device) => device,
        Err(error) => return camera_failed(config, state_of(&error), &details, &error),
    };
    let mut frame = Frame::empty();
    let mut last_error = None;
    let measured = measure(|| {
        last_error = device.poll_frame(&mut frame).err();
        device.status()
    });
    match last_error {
        None if measured.status.state == DeviceState::Working => {
            let details = format!("{details}; {:.1} frames per second", measured.rate_hz);
            let stable = nearby::CAMERAS
                .stable_name_of(Path::new(&config.device))
                .map(|name| prefer_stable_name(&name));
            Finding::usable("camera", config.device.clone(), details).advise(stable)
        }
        Some(error) => camera_failed(config, measured.status.state, &details, &error),
        None => {
            let problem =
                "it has not delivered a frame yet; check again, and check the cable if this persists"
                    .to_owned();
            Finding::unusable(
                "camera",
                config.device.clone(),
                measured.status.state,
                details,
                problem,
            )
        }
    }
}

fn camera_failed(
    config: &CameraDeviceConfig,
    state: DeviceState,
    details: &str,
    error: &V4l2Error,
) -> Finding {
    let is_missing = matches!(error, V4l2Error::NotThere { .. } | V4l2Error::NotACamera { .. });
    let others = (is_missing && config.socket().is_none()).then(|| nearby::CAMERAS.list());
    let path = config.device.clone();
    Finding::unusable("camera", path, state, details.to_owned(), error.to_string()).advise(others)
}

/// The formats that the driver reads, and the number of the others: some cameras have fifty.
fn list_formats(formats: &[FourCc]) -> String {
    let (supported, others): (Vec<FourCc>, Vec<_>) = formats
        .iter()
        .partition(|format| CameraFormat::ALL.iter().any(|ours| ours.names().contains(format)));
    let mut words: Vec<_> = supported.iter().map(ToString::to_string).collect();
    if !others.is_empty() {
        words.push(format!("{} unsupported", others.len()));
    }
    words.join(", ")
}

fn test_lidar(config: &LidarConfig) -> Finding {
    let mut device = match AnyLidar::open(config) {
        Ok(device) => device,
        Err(error) => {
            return Finding::unusable(
                "LiDAR",
                config.port.to_string(),
                state_of(&error),
                String::new(),
                error.to_string(),
            );
        }
    };
    let monitor = device.monitor();
    let mut scan = LaserScan::empty(device.geometry());
    let measured = measure(|| {
        // The status and the monitor describe a problem in more detail than this error.
        let _ = device.poll_scan(&mut scan);
        device.status()
    });
    let details = monitor.identity().map_or_else(String::new, |identity| {
        format!(
            "{}, serial {}, firmware {}",
            identity.model,
            or_unknown(identity.serial),
            or_unknown(identity.firmware)
        )
    });
    let serial = match &config.port {
        Port::Serial(path) => Some(path.as_path()),
        Port::Tcp { .. } => None,
    };
    if measured.status.state == DeviceState::Working {
        let hits = scan.ranges.iter().filter(|range| range.hit_m().is_some()).count();
        let beams = scan.ranges.len();
        let details = format!(
            "{details}; {:.1} scans per second, {hits} of {beams} beams hit something",
            measured.rate_hz
        );
        let stable = serial
            .and_then(|path| nearby::PORTS.stable_name_of(path))
            .map(|name| prefer_stable_name(&name));
        let bad = measured.status.bad;
        let noise = (bad > 0).then(|| {
            format!("{bad} scans failed their checks during the test; check cable and ground")
        });
        return Finding::usable("LiDAR", config.port.to_string(), details)
            .advise(stable)
            .advise(noise);
    }
    let starting =
        "it has not delivered a valid scan yet; it may be starting: check again".to_owned();
    let problem = monitor.problem().unwrap_or(starting);
    let others = serial.filter(|path| !path.exists()).map(|_| nearby::PORTS.list());
    Finding::unusable("LiDAR", config.port.to_string(), measured.status.state, details, problem)
        .advise(others)
}

fn or_unknown(text: String) -> String {
    if text.is_empty() { "unknown".to_owned() } else { text }
}

fn test_base(config: &BaseConfig) -> Finding {
    let mut device = match DifferentialBase::new(open_bus(&config.bus), config) {
        Ok(device) => device,
        Err(error) => {
            return Finding::unusable(
                "base",
                config.bus.clone(),
                state_of(&error),
                String::new(),
                error.to_string(),
            );
        }
    };
    let measured = measure(|| {
        // Initializes the motors, reads their watchdogs back and holds zero. The status tells whether this succeeded.
        let _ = device.poll_feedback();
        device.status()
    });
    let state = measured.status.state;
    let [left, right] = device.motors().map(describe_motor);
    let protocol = config.protocol.name();
    let details = format!(
        "{protocol}: left (node {}) {left}, right (node {}) {right}",
        config.left_node, config.right_node
    );
    let problem =
        match (device.check(), device.motors().into_iter().find_map(|motor| motor.problem)) {
            (Ok(()), None) if state == DeviceState::Working => {
                let advice = kernel_interface(config).and_then(nearby::bus_off_restart);
                return Finding::usable("base", config.bus.clone(), details).advise(advice);
            }
            (Err(CanError::Tripped(trip)), _) => trip.to_string(),
            (Err(error), _) => error.to_string(),
            (Ok(()), _) => device.explain(),
        };
    let state = if state == DeviceState::Working { DeviceState::Faulty } else { state };
    let interface = kernel_interface(config).and_then(nearby::can_interface);
    Finding::unusable("base", config.bus.clone(), state, details, problem).advise(interface)
}

/// The name of the base's CAN interface; `None` for a simulated bus.
fn kernel_interface(config: &BaseConfig) -> Option<&str> {
    (!config.bus.starts_with("unix:")).then_some(config.bus.as_str())
}

/// The emergency stop on an input line of the computer; `None` if there is none.
fn test_stop_line(config: &StopLineConfig) -> Option<Finding> {
    let line = match StopLine::start(config) {
        Ok(line) => line?,
        Err(error) => return Some(unusable_stop_line(config, error.to_string())),
    };
    let monitor = line.monitor();
    if let Some(problem) = monitor.problem() {
        return Some(unusable_stop_line(config, problem));
    }
    let is_pressed = monitor.is_pressed();
    let advice = is_pressed.then(|| {
        "release it; if it is released, its wire is broken or `released_level` is the wrong one"
            .to_owned()
    });
    let details = if is_pressed { "pressed" } else { "released; press it and check again" };
    let place = config.place();
    Some(Finding::usable(STOP_LINE, place, details.to_owned()).advise(advice))
}

fn unusable_stop_line(config: &StopLineConfig, problem: String) -> Finding {
    let state = DeviceState::Disconnected;
    Finding::unusable(STOP_LINE, config.place(), state, "counts as pressed".to_owned(), problem)
}

fn describe_motor(status: &MotorStatus) -> String {
    match status.watchdog_ms {
        Some(ms) if status.feedback_ns > 0 => format!("watchdog {ms:.0} ms"),
        Some(ms) => format!("watchdog {ms:.0} ms, no feedback"),
        None => "watchdog not confirmed".to_owned(),
    }
}

fn prefer_stable_name(name: &Path) -> String {
    format!(
        "after a restart this path may belong to another device; use {} instead",
        name.display()
    )
}

pub fn state_of(error: &impl hal::Error) -> DeviceState {
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
    fn formats_that_the_driver_does_not_read_are_counted() {
        let formats = [b"YUYV", b"UYVY", b"MJPG", b"Y16 "].map(FourCc::new);
        assert_eq!(list_formats(&formats), "YUYV, MJPG, 2 unsupported");
        assert_eq!(list_formats(&formats[..1]), "YUYV");
    }
}
