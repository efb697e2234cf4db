//! The data that `health` shows: one small file, which the running program rewrites twice a second.

use std::path::Path;

use anyhow::{Context, Result};
use drivers::{DeviceState, DeviceStatus};
use hal::PowerReport;
use runtime::calibration_watch::{Change, Measured};
use runtime::lidar_agreement::AgreementStats;
use runtime::localization::Gyroscope;
use runtime::recording::changed;
use serde::{Deserialize, Serialize};

pub use super::last_stop::LastStop;
use crate::report::atomic::write_atomically;

/// A file that is older than this was left by a program that no longer runs, seconds.
pub const STALE_S: f64 = 3.0;

/// The state of a running robot.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Status {
    /// Time at which the file was written, seconds since 1970.
    pub written_unix_s: f64,
    /// Process id of the program.
    pub pid: u32,
    /// Time since the start of the program, seconds.
    pub uptime_s: f64,
    /// State of the safety plane.
    pub safety: SafetyStatus,
    /// State of the camera.
    pub camera: DeviceHealth,
    /// State of the scanner.
    pub lidar: DeviceHealth,
    /// State of the base.
    pub base: DeviceHealth,
    /// State of the inertial measurement unit; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu: Option<DeviceHealth>,
    /// The emergency stop on an input line of the computer; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_line: Option<StopLineStatus>,
    /// The base's supply and temperature, as far as its controllers report them.
    pub power: PowerStatus,
    /// State of the exploration plane.
    pub exploration: ExplorationStatus,
    /// State of the recording.
    pub recording: RecordingStatus,
}

/// The state of the safety plane.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct SafetyStatus {
    /// The name of the state; for a fault, its reason as well.
    pub state: String,
    /// Time since the last change of the state, seconds.
    pub for_s: f64,
    /// Whether the robot stands until a person arms it.
    pub needs_person: bool,
    /// Reason and time of the last stop.
    pub last_stop: Option<LastStop>,
    /// Number of obstacles for which the robot has stopped.
    pub stops: u64,
    /// How far the wheels' motion is from the motion that the scanner measures, summed up over about five comparisons; along the
    /// heading, metres, and of the yaw, degrees.
    pub wheel_error_m: f64,
    pub wheel_error_deg: f64,
    /// Number of steps of the safety loop.
    pub steps: u64,
    /// Number of steps that were skipped because an earlier one was late.
    pub skipped: u64,
    /// Largest delay of a step, microseconds.
    pub worst_late_us: f64,
    /// Whether the thread has real-time priority.
    pub realtime: bool,
}

/// The state of a device.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct DeviceHealth {
    /// Kind and address of the device.
    pub name: String,
    /// `starting`, `working`, `silent`, `disconnected` or `faulty`.
    pub state: String,
    /// Good readings per second since the last status.
    pub rate_hz: f64,
    /// Age of the last good reading, seconds; absent before the first.
    pub age_s: Option<f64>,
    /// Readings that passed every check.
    pub good: u64,
    /// Readings that failed a check.
    pub bad: u64,
    /// Readings that never arrived.
    pub lost: u64,
    /// How often the device was opened again.
    pub reopened: u64,
    /// The problem and its remedy.
    pub problem: Option<String>,
}

/// The emergency stop on an input line of the computer.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StopLineStatus {
    /// Chip and line.
    pub place: String,
    /// Whether it is pressed. A line that cannot be read is pressed.
    pub is_pressed: bool,
    /// Why the line cannot be read, with the remedy.
    pub problem: Option<String>,
}

impl StopLineStatus {
    /// `released`, `pressed`, or that the line cannot be read.
    #[must_use]
    pub fn words(&self) -> &'static str {
        match (&self.problem, self.is_pressed) {
            (Some(_), _) => "cannot be read, which counts as pressed",
            (None, true) => "pressed, or its wire is broken",
            (None, false) => "released",
        }
    }
}

/// Supply and temperature of the base. A value that is not reported is absent.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PowerStatus {
    /// Supply voltage, V.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voltage_v: Option<f64>,
    /// Current from the supply, A.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_a: Option<f64>,
    /// The hottest motor or inverter, degrees Celsius.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Whether the robot drives slower because of that temperature.
    pub is_hot: bool,
}

impl PowerStatus {
    /// A report, judged by `hot_c` of the configuration; 0: never hot.
    #[must_use]
    pub fn new(report: &PowerReport, hot_c: f64) -> Self {
        let PowerReport { voltage_v, current_a, temperature_c } = *report;
        let is_hot = hot_c > 0.0 && temperature_c.is_some_and(|degrees| degrees > hot_c);
        Self { voltage_v, current_a, temperature_c, is_hot }
    }
}

/// The state of the exploration plane.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ExplorationStatus {
    /// Number of ticks.
    pub ticks: u64,
    /// Number of ticks that were skipped because an earlier one took too long.
    pub skipped: u64,
    /// Name of the exploration policy.
    pub policy: String,
    /// The kind of the current goal.
    pub goal: Option<String>,
    /// Why the robot does not know where it is, if so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost: Option<String>,
    /// Why the last frame has no depth; absent if it has depth.
    pub no_depth: Option<String>,
    /// Median duration of a tick, milliseconds.
    pub tick_p50_ms: f64,
    /// 99th percentile of the duration of a tick, milliseconds.
    pub tick_p99_ms: f64,
    /// Mapped floor, square metres.
    pub mapped_m2: f64,
    /// Accuracy of the depth where the LiDAR measures the same points, over about a minute; absent before the first
    /// comparison.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<AgreementStats>,
    /// The same accuracy in ranges of distance.
    pub line_by_distance: Vec<AgreementStats>,
    /// What the robot finds of its own calibration.
    pub calibration: CalibrationStatus,
    /// What was learnt of the gyroscope; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyroscope: Option<Gyroscope>,
    /// Digest of the model in use; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Digest of the model on trial, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub on_trial: Option<String>,
}

/// What the robot finds of its own calibration while it drives.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct CalibrationStatus {
    /// The last change of each parameter that has changed in this run.
    pub changes: Vec<CalibrationChange>,
    /// Every parameter as the last metres show it: its value less the configured one, rad, m and s.
    pub measured: Vec<Measured>,
}

/// A parameter that is no longer as it was at the beginning of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationChange {
    /// What has changed, by how much and since when.
    pub change: Change,
    /// When it began, seconds since 1970.
    pub since_unix_s: f64,
}

impl CalibrationChange {
    fn worry(&self, now_unix_s: f64) -> String {
        let minutes = (now_unix_s - self.since_unix_s) / 60.0;
        format!(
            "{}, {minutes:.0} min ago: look at it; `firmware-host calibrate --recording RUN` measures it again",
            changed(&self.change)
        )
    }
}

/// The state of the recording.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordingStatus {
    /// Folder of the recording.
    pub folder: Option<String>,
    /// Number of ticks that are not in the recording.
    pub dropped: u64,
    /// Why nothing is recorded at present; absent while recording works.
    pub failure: Option<String>,
    /// Number of older segments that were removed because of the quota.
    pub removed: u64,
    /// Number of removed segments that no workstation had pulled.
    pub removed_unpulled: u64,
}

impl Status {
    /// Writes the file atomically.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let json = serde_json::to_vec_pretty(self)?;
        write_atomically(path, &json)
            .with_context(|| format!("cannot write the status to {}", path.display()))
    }

    /// Reads the file.
    ///
    /// # Errors
    /// The file does not exist or is not a status.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| {
            format!(
                "no status at {}: is `firmware-host run` running? If its configuration has another run.status_file, give \
                 that by --status",
                path.display()
            )
        })?;
        let status = serde_json::from_str::<Self>(&text).ok().filter(|status| status.pid > 0);
        status.with_context(|| {
            format!("{} is not a status of this version of `firmware-host run`", path.display())
        })
    }

    /// All devices with readings.
    pub fn devices(&self) -> impl Iterator<Item = &DeviceHealth> {
        [&self.camera, &self.lidar, &self.base].into_iter().chain(&self.imu)
    }

    /// How a person lets the robot move, if it stands only because it has not been armed yet.
    #[must_use]
    pub fn arming(&self) -> Option<String> {
        let waits = self.safety.state == "disarmed" && !self.safety.needs_person;
        waits.then(|| {
            format!(
                "the robot is disarmed and stands until a person arms it: `kill -USR1 {}`, or for the service \
                 `sudo systemctl kill --signal=SIGUSR1 embodied-depth`",
                self.pid
            )
        })
    }

    /// All current problems that an operator should know; empty if the robot is healthy.
    #[must_use]
    pub fn worries(&self, now_unix_s: f64) -> Vec<String> {
        let age_s = now_unix_s - self.written_unix_s;
        let mut worries = Vec::new();
        if age_s > STALE_S {
            worries.push(format!(
                "the status is {age_s:.0} s old: the program (pid {}) has stopped or hangs",
                self.pid
            ));
        }
        worries.extend(self.devices().filter_map(DeviceHealth::worry));
        worries.extend(self.stop_line.as_ref().and_then(|line| line.problem.clone()));
        if self.safety.needs_person {
            let SafetyStatus { state, last_stop, .. } = &self.safety;
            let why = match last_stop {
                Some(stop) if state == "disarmed" => &stop.why,
                _ => state,
            };
            worries.push(format!(
                "the robot needs a person ({why}): fix the cause, then `kill -USR1 {}` arms it",
                self.pid
            ));
        } else if self.safety.state.starts_with("fault") {
            worries.push(format!(
                "the robot stands ({}) and continues on its own when that is over",
                self.safety.state
            ));
        }
        if let Some(degrees) = self.power.temperature_c.filter(|_| self.power.is_hot) {
            worries.push(format!(
                "the base is hot ({degrees:.0} degrees): the robot drives slower until it has cooled down"
            ));
        }
        worries.extend(
            self.exploration
                .lost
                .as_ref()
                .map(|why| format!("the robot does not know where it is and searches: {why}")),
        );
        let changes = &self.exploration.calibration.changes;
        worries.extend(changes.iter().map(|change| change.worry(now_unix_s)));
        worries.extend(
            self.recording
                .failure
                .as_ref()
                .map(|failure| format!("nothing is recorded: {failure}")),
        );
        worries
    }
}

impl DeviceHealth {
    /// What is wrong with the device, and its remedy; `None` if it works.
    #[must_use]
    pub fn worry(&self) -> Option<String> {
        if self.state == DeviceState::Working.to_string() {
            return None;
        }
        // Some drivers begin their messages with the name of the device.
        let problem = self.problem.as_ref().map_or_else(String::new, |problem| {
            let problem = problem
                .strip_prefix(&self.name)
                .map_or(problem.as_str(), |rest| rest.trim_start_matches([':', ' ']));
            format!(": {problem}")
        });
        Some(format!("{} is {}{problem}", self.name, self.state))
    }
}

/// Converts counts to rates.
#[derive(Debug, Clone, Copy, Default)]
pub struct RateMeter {
    last: Option<(u64, u64)>,
    rate_hz: f64,
}

impl RateMeter {
    /// Good readings per second since the last call.
    fn rate_hz(&mut self, good: u64, now_ns: u64) -> f64 {
        if let Some((then_ns, then)) = self.last.replace((now_ns, good))
            && now_ns > then_ns
        {
            self.rate_hz = good.saturating_sub(then) as f64 / ((now_ns - then_ns) as f64 * 1e-9);
        }
        self.rate_hz
    }

    /// The health of a device from its driver's counts.
    pub fn health(
        &mut self,
        name: &str,
        status: &DeviceStatus,
        now_ns: u64,
        problem: Option<String>,
    ) -> DeviceHealth {
        DeviceHealth {
            name: name.to_owned(),
            state: status.state.to_string(),
            rate_hz: self.rate_hz(status.good, now_ns),
            age_s: (status.last_good_ns > 0)
                .then(|| now_ns.saturating_sub(status.last_good_ns) as f64 * 1e-9),
            good: status.good,
            bad: status.bad,
            lost: status.lost,
            reopened: status.reopened,
            problem: problem.filter(|_| status.state != DeviceState::Working),
        }
    }
}

/// The current time, seconds since 1970.
#[must_use]
pub fn unix_s() -> f64 {
    std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;
    use runtime::calibration_watch::{Manner, Watched};

    fn working(name: &str) -> DeviceHealth {
        DeviceHealth {
            name: name.to_owned(),
            state: "working".to_owned(),
            ..DeviceHealth::default()
        }
    }

    fn well() -> Status {
        let safety = SafetyStatus { state: "clear".to_owned(), ..SafetyStatus::default() };
        Status {
            written_unix_s: 100.0,
            pid: 7,
            safety,
            camera: working("camera"),
            lidar: working("LiDAR"),
            base: working("base"),
            ..Status::default()
        }
    }

    #[test]
    fn a_robot_that_is_well_gives_no_worries() {
        assert_eq!(well().worries(101.0), Vec::<String>::new());
    }

    #[test]
    fn every_worry_names_the_thing_and_the_way_out() {
        let mut status = well();
        status.lidar.state = "disconnected".to_owned();
        status.lidar.problem = Some("LiDAR: /dev/ttyACM0 is not there".to_owned());
        status.safety = SafetyStatus {
            state: "fault: bus".to_owned(),
            needs_person: true,
            ..SafetyStatus::default()
        };
        status.recording.failure = Some("disk full".to_owned());
        let hot = PowerReport { temperature_c: Some(88.0), ..PowerReport::default() };
        status.power = PowerStatus::new(&hot, 80.0);
        let worries = status.worries(110.0).join("\n");
        for part in [
            "10 s old",
            "pid 7",
            "LiDAR is disconnected: /dev/ttyACM0",
            "kill -USR1 7",
            "disk full",
            "88 degrees",
        ] {
            assert!(worries.contains(part), "{part} in {worries}");
        }
    }

    #[test]
    fn a_changed_calibration_is_a_worry_with_its_size_its_time_and_the_way_out() {
        let mut status = well();
        let change = Change {
            what: Watched::CameraPitch,
            by: 0.0175,
            sigma: 0.002,
            since_m: 312.4,
            since_ns: 5_000_000_000,
            manner: Manner::AtOnce,
        };
        status.exploration.calibration.changes =
            vec![CalibrationChange { change, since_unix_s: 100.0 }];
        let worries = status.worries(100.0 + 180.0).join("\n");
        for part in ["1.0 degrees more down", "after 312 m", "3 min ago", "calibrate --recording"] {
            assert!(worries.contains(part), "{part} in {worries}");
        }
    }

    #[test]
    fn a_status_comes_back_as_it_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("status.json");
        well().write(&path).unwrap();
        assert_eq!(Status::read(&path).unwrap(), well());
        assert!(
            Status::read(&dir.path().join("none")).unwrap_err().to_string().contains("--status")
        );
    }

    #[test]
    fn rates_are_counted_between_two_looks() {
        let mut meter = RateMeter::default();
        let status =
            |good| DeviceStatus { state: DeviceState::Working, good, ..DeviceStatus::default() };
        meter.health("x", &status(0), 1_000_000_000, None);
        let health = meter.health("x", &status(20), 1_500_000_000, None);
        assert!((health.rate_hz - 40.0).abs() < 1e-9);
    }
}
