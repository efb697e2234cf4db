//! Live visualization of a run in the Rerun viewer, or as the file `run.rrd` (feature `rerun`).
//!
//! The control loop puts a [`Moment`] into a short queue and continues. A separate thread encodes
//! and sends it. If the thread is slower than the loop, moments are dropped and counted.

mod encode;
mod log;

use std::{
    path::PathBuf,
    sync::mpsc::{SyncSender, TrySendError, sync_channel},
    thread::JoinHandle,
};

use hal::{CameraModel, Pose2, Pose3};
use runtime::recording::Views;

use log::RunLog;

/// Name of the file in the output directory.
pub const RERUN_FILE: &str = "run.rrd";

/// Capacity of the queue, in moments: enough for the time that encoding a map takes.
const QUEUE: usize = 16;

/// Where to send the visualization.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RerunTargets {
    /// A file to write.
    pub file: Option<PathBuf>,
    /// A running viewer, such as `rerun+http://127.0.0.1:9876/proxy`.
    pub viewer: Option<String>,
}

/// The visualized data of one tick.
#[derive(Debug, Clone, Default)]
pub struct Moment {
    pub tick: u64,
    pub time_ns: u64,
    /// Where the robot believes to be, `t_map_base`.
    pub t_map_base: Pose2,
    /// Current goal in `map`, metres.
    pub goal_m: Option<[f64; 2]>,
    /// Camera image: width, height, RGB8.
    pub image: Option<(usize, usize, Vec<u8>)>,
    /// Map, path and depth, each if it has changed.
    pub views: Views,
    /// Values to plot over time, by name, such as `coverage`.
    pub numbers: Vec<(&'static str, f64)>,
}

/// Counts of moments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RerunCounts {
    pub sent: u64,
    /// Dropped because the thread was slower than the loop.
    pub dropped: u64,
    /// Values that could not be encoded or sent.
    pub failed: u64,
}

/// Why the visualization cannot be started.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RerunError {
    /// The file or the viewer cannot be opened.
    #[error("cannot send the run to {target}: {reason}")]
    Target {
        target: String,
        /// Error message of Rerun.
        reason: String,
    },
    /// The thread cannot be started.
    #[error("cannot start the thread for the visualization: {0}")]
    Thread(#[from] std::io::Error),
}

/// Sends moments to the thread that encodes them.
#[derive(Debug)]
pub struct RerunStream {
    queue: SyncSender<Moment>,
    thread: JoinHandle<RerunCounts>,
    dropped: u64,
}

impl RerunStream {
    /// Opens the targets and starts the thread. `t_base_camera` is the camera's mount.
    ///
    /// # Errors
    /// [`RerunError`]. A viewer that is not running is not an error, because it may be started later.
    pub fn start(
        targets: &RerunTargets,
        camera: &CameraModel,
        t_base_camera: &Pose3,
    ) -> Result<Self, RerunError> {
        let mut log = RunLog::open(targets, camera, t_base_camera)?;
        Self::with(move |moment| log.moment(moment), QUEUE)
    }

    /// Starts a thread that calls `send`, which returns the number of failed values.
    fn with(
        mut send: impl FnMut(&Moment) -> u64 + Send + 'static,
        queue: usize,
    ) -> Result<Self, RerunError> {
        let (sender, receiver) = sync_channel::<Moment>(queue);
        let thread = std::thread::Builder::new().name("rerun".to_owned()).spawn(move || {
            let mut counts = RerunCounts::default();
            for moment in receiver {
                counts.failed += send(&moment);
                counts.sent += 1;
            }
            counts
        })?;
        Ok(Self { queue: sender, thread, dropped: 0 })
    }

    /// Sends a moment if the queue is not full. Never blocks.
    pub fn offer(&mut self, moment: Moment) {
        match self.queue.try_send(moment) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => self.dropped += 1,
        }
    }

    /// Waits until all queued moments are sent.
    #[must_use]
    pub fn finish(self) -> RerunCounts {
        drop(self.queue);
        // If the thread panicked, its counts are lost, but the run continues.
        let counts = self.thread.join().unwrap_or_default();
        RerunCounts { dropped: self.dropped, ..counts }
    }
}

#[cfg(test)]
mod tests {
    use hal::{DepthMap, camera_mount};
    use runtime::recording::MapView;

    use super::*;

    #[test]
    fn a_slow_viewer_drops_moments_and_never_blocks_the_loop() {
        let (release, wait) = sync_channel::<()>(0);
        let mut stream = RerunStream::with(
            move |_: &Moment| {
                let _ = wait.recv();
                0
            },
            2,
        )
        .unwrap();
        for tick in 0..50 {
            stream.offer(Moment { tick, ..Moment::default() });
        }
        drop(release);
        let counts = stream.finish();
        assert_eq!(counts.sent + counts.dropped, 50);
        // Two are in the queue, and the thread may have taken one.
        assert!((2..=3).contains(&counts.sent), "{counts:?}");
    }

    #[test]
    fn a_run_is_written_into_a_file() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join(RERUN_FILE);
        let targets = RerunTargets { file: Some(file.clone()), viewer: None };
        let camera = CameraModel::pinhole(64, 32, 1.5);
        let mut log = RunLog::open(&targets, &camera, &camera_mount(0.0, 0.8, 0.0)).unwrap();
        let map =
            MapView { origin_m: [-1.0, -1.0], cell_m: 0.1, columns: 20, occupancy: vec![-1; 400] };
        for tick in 0..30 {
            let moment = Moment {
                tick,
                time_ns: tick * 100_000_000,
                t_map_base: Pose2::new(0.03 * tick as f64, 0.0, 0.1),
                goal_m: Some([1.0, 0.5]),
                image: Some((64, 32, vec![90; 64 * 32 * 3])),
                views: Views {
                    map: Some(map.clone()),
                    path_m: Some(vec![[0.0, 0.0], [1.0, 0.5]]),
                    depth: DepthMap::from_vec(64, 32, vec![2.0; 64 * 32]),
                },
                numbers: vec![("coverage", 0.01 * tick as f64), ("delta1", f64::NAN)],
            };
            assert_eq!(log.moment(&moment), 0);
        }
        drop(log);
        assert!(std::fs::metadata(file).unwrap().len() > 10_000);
    }

    #[test]
    fn a_file_that_cannot_be_written_is_named() {
        let targets = RerunTargets { file: Some("/nowhere/run.rrd".into()), viewer: None };
        let error = RunLog::open(&targets, &CameraModel::pinhole(64, 32, 1.5), &Pose3::identity())
            .err()
            .unwrap();
        assert!(error.to_string().contains("/nowhere/run.rrd"), "{error}");
        let targets = RerunTargets { file: None, viewer: Some("not a url".into()) };
        assert!(
            RunLog::open(&targets, &CameraModel::pinhole(64, 32, 1.5), &Pose3::identity()).is_err()
        );
    }
}
