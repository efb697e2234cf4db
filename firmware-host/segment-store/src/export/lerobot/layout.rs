//! Names and sizes of a LeRobot dataset.

/// The RGB image of the camera.
pub(super) const IMAGE: &str = "observation.images.front";
/// The localized pose and the measured velocity.
pub(super) const STATE: &str = "observation.state";
/// The command that was sent to the base, after the safety loop has limited it.
pub(super) const ACTION: &str = "action";
/// The real time. Not below `observation.`, because policies would take it for an observation.
pub(super) const TIME: &str = "time_s";

pub(super) const EPISODE_FILE: &str = "meta/episodes/chunk-000/file-000.parquet";
pub(super) const TASKS_FILE: &str = "meta/tasks.parquet";

/// When an episode ends and the data file is larger than this, the next episode starts a new file. LeRobot's default.
pub(super) const MAX_DATA_FILE: u64 = 100 << 20;
/// The number of data files per directory.
pub(super) const CHUNK_FILES: i64 = 1000;
/// The number of frames in a row group, which is written from memory. `datasets` recommends this size for images.
pub(super) const ROW_GROUP: usize = 100;
/// A longer time between two images ends an episode.
pub(super) const BREAK_NS: u64 = 1_000_000_000;

/// The position of an episode in the dataset.
#[derive(Debug, Clone, Copy)]
pub(super) struct Episode {
    pub from: i64,
    pub to: i64,
    pub chunk: i64,
    pub file: i64,
    pub start_s: f64,
}
