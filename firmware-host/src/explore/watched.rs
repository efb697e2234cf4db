//! The live view of a simulated run: orders before a tick, and the run's health.

use std::time::{Duration, Instant};

use runtime::mapping::CellState;
use runtime::session::Session;

use super::devices::SimulatedDevices;
use super::session::RunLog;
use crate::control_panel::{ControlPanel, Plane};
use crate::live::Live;
use crate::record::Recorder;
use crate::report::latency::Stage;
use crate::run::status::{ExplorationStatus, RecordingStatus, SafetyStatus, Status, unix_s};

/// Period of the health, in the wall's time.
const HEALTH_EVERY: Duration = Duration::from_millis(500);

/// The live view of a simulated run.
pub(super) struct Watched {
    pub live: Live,
    panel: ControlPanel,
    folder: Option<String>,
    began: Instant,
    health_due: Instant,
}

impl Watched {
    /// The view of a run that records into `folder`.
    pub fn new(live: Live, panel: ControlPanel, folder: Option<String>) -> Self {
        let began = Instant::now();
        Self { live, panel, folder, began, health_due: began }
    }

    /// Whether the health is due.
    fn health_is_due(&mut self) -> bool {
        let now = Instant::now();
        let is_due = now >= self.health_due;
        if is_due {
            self.health_due = now + HEALTH_EVERY;
        }
        is_due
    }
}

/// Takes the orders that have come, and shows the run's health when it is due.
pub(super) fn attend(log: &mut RunLog, session: &mut Session<SimulatedDevices>) {
    let RunLog { watched: Some(watched), map, .. } = log else { return };
    watched.live.serve(session, map.as_mut());
    if watched.health_is_due() {
        let status = status(log, session);
        if let Some(watched) = &mut log.watched {
            watched.live.show_health(&status);
        }
    }
}

/// As far as a simulation has what a robot has.
fn status(log: &RunLog, session: &Session<SimulatedDevices>) -> Status {
    let Some(watched) = &log.watched else { return Status::default() };
    let robot = session.robot();
    let map = robot.map();
    let free = map.known_cells().filter(|(cell, _)| map.state(*cell) == CellState::Free).count();
    let plane = watched.panel.plane();
    let total = log.stopwatch.latencies().percentiles().get(&Stage::Total).copied();
    let recorder = log.recorder.as_ref();
    Status {
        written_unix_s: unix_s(),
        pid: std::process::id(),
        uptime_s: watched.began.elapsed().as_secs_f64(),
        safety: SafetyStatus {
            state: plane.words(),
            needs_person: matches!(plane, Plane::Fault(why) if why.needs_person()),
            stops: log.evaluation.trips_m().len() as u64,
            ..SafetyStatus::default()
        },
        exploration: ExplorationStatus {
            ticks: session.ticks(),
            skipped: session.skipped(),
            policy: robot.explorer().policy().name().to_owned(),
            tick_p50_ms: total.map_or(0.0, |total| total.p50),
            tick_p99_ms: total.map_or(0.0, |total| total.p99),
            mapped_m2: free as f64 * map.cell_m() * map.cell_m(),
            line: log.line.overall(),
            model: robot.network_digest(),
            ..ExplorationStatus::default()
        },
        recording: RecordingStatus {
            folder: watched.folder.clone().filter(|_| recorder.is_some()),
            dropped: recorder.map_or(0, Recorder::dropped),
            failure: recorder.and_then(|recorder| recorder.status().failure),
            ..RecordingStatus::default()
        },
        ..Status::default()
    }
}
