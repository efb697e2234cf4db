//! The files below `meta/` other than the statistics.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::layout::{ACTION, EPISODE_FILE, Episode, IMAGE, MAX_DATA_FILE, STATE, TASKS_FILE, TIME};
use super::table::{Table, Values};
use crate::error::StoreError;

/// The contents of `meta/info.json`.
pub(super) struct Info {
    pub episodes: usize,
    pub frames: i64,
    pub fps: u32,
    pub width: usize,
    pub height: usize,
}

impl Info {
    pub(super) fn json(&self) -> Value {
        let image_axes = json!(["height", "width", "channels"]);
        let state_names = json!(["x_m", "y_m", "yaw_rad", "linear_mps", "angular_radps"]);
        let action_names = json!(["linear_mps", "angular_radps"]);
        let mut features = Map::from_iter([
            feature(IMAGE, "image", &json!([self.height, self.width, 3]), &image_axes),
            feature(STATE, "float32", &json!([5]), &state_names),
            feature(ACTION, "float32", &json!([2]), &action_names),
            feature(TIME, "float64", &json!([1]), &Value::Null),
            feature("timestamp", "float32", &json!([1]), &Value::Null),
        ]);
        let indices = ["frame_index", "episode_index", "index", "task_index"];
        features.extend(indices.map(|name| feature(name, "int64", &json!([1]), &Value::Null)));
        json!({
            "codebase_version": "v3.0",
            "robot_type": "embodied-depth",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": MAX_DATA_FILE >> 20,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": format!("0:{}", self.episodes)},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": features,
        })
    }
}

fn feature(name: &str, dtype: &str, shape: &Value, names: &Value) -> (String, Value) {
    (name.to_owned(), json!({"dtype": dtype, "shape": shape, "names": names}))
}

/// Writes the table of episodes: where each one is in the data files.
pub(super) fn write_episodes(
    dir: &Path,
    episodes: &[Episode],
    task: &str,
) -> Result<(), StoreError> {
    let numbers: Vec<i64> = (0..episodes.len() as i64).collect();
    let zeros = vec![0; episodes.len()];
    let lengths: Vec<i64> = episodes.iter().map(|episode| episode.to - episode.from).collect();
    let chunks: Vec<i64> = episodes.iter().map(|episode| episode.chunk).collect();
    let files: Vec<i64> = episodes.iter().map(|episode| episode.file).collect();
    let from: Vec<i64> = episodes.iter().map(|episode| episode.from).collect();
    let to: Vec<i64> = episodes.iter().map(|episode| episode.to).collect();
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
        // Not part of LeRobot's format: the start on the run's clock, to find the episode in the recording.
        ("start_time_s", Values::Doubles(&starts)),
    ];
    let mut table = Table::create(&dir.join(EPISODE_FILE), &columns)?;
    table.append(&columns)?;
    table.finish()
}

/// Writes the table with the only task, in the form in which pandas writes a frame that is indexed by task.
pub(super) fn write_tasks(dir: &Path, task: &str) -> Result<(), StoreError> {
    let columns = [("task_index", Values::Integers(&[0])), ("task", Values::Texts(&[task]))];
    let mut table = Table::create(&dir.join(TASKS_FILE), &columns)?;
    table.append(&columns)?;
    let frame = json!({
        "index_columns": ["task"],
        "column_indexes": [{"name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            pandas_column("task_index", "int64", "int64"),
            pandas_column("task", "unicode", "object"),
        ],
        "pandas_version": "2.2.0",
    });
    table.for_pandas(frame.to_string());
    table.finish()
}

fn pandas_column(name: &str, pandas_type: &str, numpy_type: &str) -> Value {
    json!({
        "name": name, "field_name": name, "pandas_type": pandas_type, "numpy_type": numpy_type,
        "metadata": null,
    })
}

/// Writes a JSON file below `meta/`.
pub(super) fn write_json(dir: &Path, name: &str, value: &Value) -> Result<(), StoreError> {
    let path = dir.join("meta").join(name);
    let text = serde_json::to_vec_pretty(value).map_err(std::io::Error::other);
    text.and_then(|text| std::fs::write(&path, text)).map_err(StoreError::output(path))
}
