//! What is in `meta/` besides statistics.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::table::{Table, Values};
use super::{ACTION, EPISODE_FILE, Episode, PICTURE, STATE, TASKS_FILE, TIME};
use crate::error::BufferError;

/// What `meta/info.json` says of the whole.
pub(super) struct Info {
    pub episodes: usize,
    pub frames: i64,
    pub fps: u32,
    pub width: usize,
    pub height: usize,
}

impl Info {
    pub(super) fn json(&self) -> Value {
        let mut features = Map::new();
        let mut feature = |name: &str, dtype: &str, shape: Value, names: Value| {
            features
                .insert(name.to_owned(), json!({"dtype": dtype, "shape": shape, "names": names}));
        };
        feature(
            PICTURE,
            "image",
            json!([self.height, self.width, 3]),
            json!(["height", "width", "channels"]),
        );
        feature(
            STATE,
            "float32",
            json!([5]),
            json!(["x_m", "y_m", "yaw_rad", "linear_mps", "angular_radps"]),
        );
        feature(ACTION, "float32", json!([2]), json!(["linear_mps", "angular_radps"]));
        feature(TIME, "float64", json!([1]), Value::Null);
        feature("timestamp", "float32", json!([1]), Value::Null);
        for index in ["frame_index", "episode_index", "index", "task_index"] {
            feature(index, "int64", json!([1]), Value::Null);
        }
        json!({
            "codebase_version": "v3.0",
            "robot_type": "embodied-depth",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": super::MAX_DATA_FILE >> 20,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": format!("0:{}", self.episodes)},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": features,
        })
    }
}

/// Where each episode is.
pub(super) fn write_episodes(
    dir: &Path,
    episodes: &[Episode],
    task: &str,
) -> Result<(), BufferError> {
    let column = |of: &dyn Fn(&Episode) -> i64| episodes.iter().map(of).collect::<Vec<_>>();
    let numbers: Vec<i64> = (0..episodes.len() as i64).collect();
    let (lengths, zeros) = (column(&|episode| episode.to - episode.from), vec![0; episodes.len()]);
    let (chunks, files) = (column(&|episode| episode.chunk), column(&|episode| episode.file));
    let (from, to) = (column(&|episode| episode.from), column(&|episode| episode.to));
    let starts: Vec<f64> = episodes.iter().map(|episode| episode.start_s).collect();
    let tasks = vec![task; episodes.len()];
    let columns = [
        ("episode_index", Values::Integers(&numbers)),
        ("tasks", Values::TextLists(&tasks)),
        ("length", Values::Integers(&lengths)),
        ("data/chunk_index", Values::Integers(&chunks)),
        ("data/file_index", Values::Integers(&files)),
        ("dataset_from_index", Values::Integers(&from)),
        ("dataset_to_index", Values::Integers(&to)),
        ("meta/episodes/chunk_index", Values::Integers(&zeros)),
        ("meta/episodes/file_index", Values::Integers(&zeros)),
        // Ours: on the run's clock, to find the place in the recording.
        ("start_time_s", Values::Doubles(&starts)),
    ];
    let mut table = Table::create(&dir.join(EPISODE_FILE), &columns)?;
    table.append(&columns)?;
    table.finish()
}

/// The one task, as pandas writes a frame whose index are the tasks.
pub(super) fn write_tasks(dir: &Path, task: &str) -> Result<(), BufferError> {
    let columns = [("task_index", Values::Integers(&[0])), ("task", Values::Texts(&[task]))];
    let mut table = Table::create(&dir.join(TASKS_FILE), &columns)?;
    table.append(&columns)?;
    let column = |name: &str, pandas: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": pandas, "numpy_type": numpy, "metadata": null});
    let frame = json!({
        "index_columns": ["task"],
        "column_indexes": [{"name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"}}],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "pandas_version": "2.2.0",
    });
    table.for_pandas(frame.to_string());
    table.finish()
}

/// Writes a JSON file below `meta/`.
pub(super) fn write_json(dir: &Path, name: &str, value: &Value) -> Result<(), BufferError> {
    let path = dir.join("meta").join(name);
    let text = serde_json::to_vec_pretty(value).map_err(std::io::Error::other);
    text.and_then(|text| std::fs::write(&path, text)).map_err(BufferError::write(path))
}
