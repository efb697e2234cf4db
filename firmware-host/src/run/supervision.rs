//! Reports the state of the robot to systemd and `health`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::DeviceState;
use drivers::can::Phase;
use drivers::iio::ImuMonitor;
use monotonic_clock::monotonic_ns;
use runtime::event::FaultReason;
use runtime::recording::fault_reason;
use runtime::safety::SafetyState;
use sd_notify::NotifyState;

use super::device_log::DeviceLog;
use super::devices::Monitors;
use super::exploration::Exploration;
use super::last_stop::LastStop;
use super::operator::Operator;
use super::safety_thread::{LoopStatus, SafetyThread};
use super::state_words::state_words;
use super::status::{
    PowerStatus, RateMeter, RecordingStatus, SafetyStatus, Status, StopLineStatus, unix_s,
};
use crate::cli::RunArgs;
use crate::config::Config;
use crate::failure::sentence;

/// Period of the reports.
const EVERY_NS: u64 = 500_000_000;

/// Reports the state of the robot to systemd and `health`.
pub struct Supervision {
    file: PathBuf,
    folder: Option<String>,
    names: [String; 4],
    bus: String,
    hot_c: f64,
    /// Chip and line of the emergency stop.
    stop_line: String,
    monitors: Monitors,
    /// The inertial measurement unit, if there is one.
    imu: Option<ImuMonitor>,
    meters: [RateMeter; 4],
    began_ns: u64,
    due_ns: u64,
    heartbeat: Heartbeat,
    /// A stop that needs a person is in the file.
    held: Arc<AtomicBool>,
    last_stop: Option<LastStop>,
    /// Why the last request to arm was cancelled, as far as it was reported.
    lapsed: Option<FaultReason>,
    unwritable: bool,
    devices: DeviceLog,
}

impl Supervision {
    /// Supervision that has reported nothing yet.
    pub fn new(
        args: &RunArgs,
        out: &Path,
        config: &Config,
        monitors: Monitors,
        imu: Option<ImuMonitor>,
        operator: &Operator,
    ) -> Self {
        let file = args.status.clone().unwrap_or_else(|| PathBuf::from(&config.run.status_file));
        if let Some(folder) = file.parent() {
            // If the folder cannot be created, writing the status reports the error.
            let _ = std::fs::create_dir_all(folder);
        }
        let devices = &config.devices;
        Self {
            file,
            folder: (!args.no_recording).then(|| out.display().to_string()),
            names: [
                format!("camera {}", devices.camera.device),
                format!("LiDAR {}", devices.lidar.port),
                format!("base {}", devices.base.bus),
                format!("IMU {}", devices.imu.device),
            ],
            bus: devices.base.bus.clone(),
            hot_c: config.safety.hot_c,
            stop_line: devices.emergency_stop.place(),
            monitors,
            imu,
            meters: [RateMeter::default(); 4],
            began_ns: monotonic_ns(),
            due_ns: 0,
            heartbeat: Heartbeat::default(),
            held: Arc::clone(&operator.held),
            last_stop: operator.last_stop.clone(),
            lapsed: None,
            unwritable: false,
            devices: DeviceLog::default(),
        }
    }

    /// Reports to systemd that the robot is ready, and prints how to control it.
    pub fn announce(&self, safety: &SafetyThread) {
        let _ = sd_notify::notify(&[NotifyState::Ready]);
        let realtime = if safety.realtime { "with" } else { "without" };
        eprintln!(
            "running, {realtime} real-time priority. `firmware-host health --status {}` shows how it is; \
             SIGUSR1 arms, SIGUSR2 stops, SIGINT, SIGTERM or SIGHUP ends.",
            self.file.display()
        );
    }

    /// Reports to systemd that the program is ending, and removes the status file.
    pub fn good_bye(&self) {
        let _ = sd_notify::notify(&[NotifyState::Stopping]);
        let _ = std::fs::remove_file(&self.file);
    }

    /// Feeds systemd's watchdog and writes the status when they are due. The caller calls this
    /// after every tick.
    pub fn update(&mut self, safety: &mut SafetyThread, exploration: &mut Exploration) {
        let safety_status = *safety.status.read();
        if let SafetyState::Fault(_) | SafetyState::Tripped { .. } = safety_status.state {
            self.last_stop =
                Some(LastStop { why: state_words(&safety_status.state), unix_s: unix_s() });
        }
        if self.lapsed != safety_status.lapsed {
            self.lapsed = safety_status.lapsed;
            if let Some(why) = self.lapsed {
                let why = format!("arming was cancelled: {}", fault_reason(why));
                tracing::warn!("{why}; send SIGUSR1 to arm");
                self.last_stop = Some(LastStop { why, unix_s: unix_s() });
            }
        }
        let now_ns = monotonic_ns();
        if now_ns < self.due_ns {
            return;
        }
        self.due_ns = now_ns + EVERY_NS;
        // systemd's watchdog is fed only while both loops run. The exploration loop has just run.
        self.heartbeat.count(safety.steps.load(Ordering::Acquire), || {
            let _ = sd_notify::notify(&[NotifyState::Watchdog]);
        });
        let status = self.status(&safety_status, safety.realtime, exploration, now_ns);
        for change in self.devices.changes(status.devices(), status.uptime_s) {
            tracing::warn!("{change}");
        }
        if let Some(live) = &mut exploration.log.live {
            live.show_health(&status);
        }
        if let Err(error) = status.write(&self.file)
            && !std::mem::replace(&mut self.unwritable, true)
        {
            tracing::warn!("{}; `health` will have nothing to show", sentence(&error));
        }
    }

    fn status(
        &mut self,
        safety: &LoopStatus,
        realtime: bool,
        exploration: &Exploration,
        now_ns: u64,
    ) -> Status {
        let (camera, camera_problem) = exploration.camera();
        let [camera_meter, lidar_meter, base_meter, imu_meter] = &mut self.meters;
        let base_problem = match (safety.phase, safety.base.state) {
            (Phase::Tripped(trip), _) => Some(trip.to_string()),
            (_, DeviceState::Disconnected) => Some(no_bus(&self.bus)),
            (_, DeviceState::Silent | DeviceState::Starting) => Some(
                "the motors' controllers do not answer: are they powered, and are the nodes right?"
                    .to_owned(),
            ),
            _ => None,
        };
        let recorder = exploration.log.recorder.as_ref();
        Status {
            written_unix_s: unix_s(),
            pid: std::process::id(),
            uptime_s: (now_ns - self.began_ns) as f64 * 1e-9,
            safety: SafetyStatus {
                state: state_words(&safety.state),
                for_s: now_ns.saturating_sub(safety.since_ns.max(self.began_ns)) as f64 * 1e-9,
                needs_person: match safety.state {
                    SafetyState::Fault(why) => why.needs_person(),
                    SafetyState::Disarmed => {
                        safety.lapsed.is_some() || self.held.load(Ordering::Acquire)
                    }
                    _ => false,
                },
                last_stop: self.last_stop.clone(),
                stops: safety.trips,
                wheel_error_m: safety.wheel_error.forward_m,
                wheel_error_deg: safety.wheel_error.yaw_rad.to_degrees(),
                steps: safety.steps,
                skipped: safety.skipped,
                worst_late_us: safety.worst_late_ns as f64 * 1e-3,
                realtime,
            },
            camera: camera_meter.health(&self.names[0], &camera, now_ns, camera_problem.cloned()),
            lidar: lidar_meter.health(
                &self.names[1],
                &safety.lidar,
                now_ns,
                self.monitors.lidar.problem(),
            ),
            base: base_meter.health(&self.names[2], &safety.base, now_ns, base_problem),
            imu: self
                .imu
                .as_ref()
                .map(|imu| imu_meter.health(&self.names[3], &imu.status(), now_ns, imu.problem())),
            stop_line: self.monitors.stop_line.as_ref().map(|line| StopLineStatus {
                place: self.stop_line.clone(),
                is_pressed: line.is_pressed(),
                problem: line.problem(),
            }),
            power: PowerStatus::new(&safety.power, self.hot_c),
            exploration: exploration.status(),
            recording: RecordingStatus {
                folder: self.folder.clone(),
                dropped: recorder.map_or(0, crate::record::Recorder::dropped),
                failure: recorder.and_then(|recorder| recorder.status().failure),
                removed: recorder.map_or(0, |recorder| recorder.status().removed.segments),
                removed_unpulled: recorder
                    .map_or(0, |recorder| recorder.status().removed.not_pulled),
            },
        }
    }
}

/// Feeds a watchdog while the number of a loop's steps grows.
#[derive(Debug, Clone, Copy, Default)]
struct Heartbeat {
    steps: u64,
}

impl Heartbeat {
    /// Takes the number of steps so far, and feeds if there was one since the last call.
    fn count(&mut self, steps: u64, feed: impl FnOnce()) {
        if std::mem::replace(&mut self.steps, steps) != steps {
            feed();
        }
    }
}

fn no_bus(bus: &str) -> String {
    if bus.starts_with("unix:") {
        return "no simulated bus listens there; start `hil world` or `hil motor`".to_owned();
    }
    format!(
        "the interface is not there or down; `ip link set {bus} up type can bitrate 500000 restart-ms 100` brings it up"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systemds_watchdog_is_fed_only_while_the_steps_of_the_safety_loop_grow() {
        let mut heartbeat = Heartbeat::default();
        let mut fed_at = Vec::new();
        for (call, steps) in [0, 50, 50, 50, 51].into_iter().enumerate() {
            heartbeat.count(steps, || fed_at.push(call));
        }
        assert_eq!(fed_at, [1, 4]);
    }
}
