//! The rows of the data tables. They are collected and written as columns, one row group at a time.

use image::ExtendedColorType;
use parquet::data_type::ByteArray;
use runtime::recording::{RecordedTick, RgbImage};
use serde_json::{Value, json};

use super::layout::{ACTION, IMAGE, STATE, TIME};
use super::stats::{Numbers, Pixels};
use super::table::{Column, Values};
use crate::error::StoreError;
use crate::export::ticks::png;

/// x, y, yaw, linear velocity, angular velocity.
pub(super) type State = [f32; 5];
/// Linear and angular velocity.
pub(super) type Action = [f32; 2];

/// The state of a tick: odometry and measured velocity. `None` when a value is not finite.
pub(super) fn state(tick: &RecordedTick) -> Option<State> {
    let odom = &tick.wheel.odom;
    let twist = &tick.wheel.twist;
    let state = [odom.x_m, odom.y_m, odom.yaw_rad, twist.linear_mps, twist.angular_radps]
        .map(|value| value as f32);
    state.iter().all(|value| value.is_finite()).then_some(state)
}

/// The action that answered the tick before `next`: the command that was in force when `next` began.
pub(super) fn action_before(next: &RecordedTick) -> Option<Action> {
    let sent = next.decision.as_ref()?.sent?;
    let action = [sent.linear_mps, sent.angular_radps].map(|value| value as f32);
    action.iter().all(|value| value.is_finite()).then_some(action)
}

/// The rows that have not been written yet, and the statistics of all rows.
pub(super) struct Rows {
    size: Option<(usize, usize)>,
    images: Vec<ByteArray>,
    states: Vec<f32>,
    actions: Vec<f32>,
    times_ns: Vec<u64>,
    frames: Vec<i64>,
    episodes: Vec<i64>,
    /// The number of the next row in its episode.
    frame: i64,
    /// The time of the first row of the episode.
    start_ns: u64,
    /// The times of the waiting rows, in seconds since the start of their episode.
    times_s: Vec<f64>,
    /// The number of all rows, including those that wait.
    total: i64,
    stats: Stats,
}

fn as_floats(values: &[i64]) -> impl Iterator<Item = f64> {
    values.iter().map(|value| *value as f64)
}

struct Stats {
    pixels: Pixels,
    state: Numbers,
    action: Numbers,
    time: Numbers,
    timestamp: Numbers,
    frame: Numbers,
    episode: Numbers,
    index: Numbers,
    task: Numbers,
}

impl Default for Rows {
    fn default() -> Self {
        let stats = Stats {
            pixels: Pixels::default(),
            state: Numbers::new(5),
            action: Numbers::new(2),
            time: Numbers::new(1),
            timestamp: Numbers::new(1),
            frame: Numbers::new(1),
            episode: Numbers::new(1),
            index: Numbers::new(1),
            task: Numbers::new(1),
        };
        Self {
            size: None,
            images: Vec::new(),
            states: Vec::new(),
            actions: Vec::new(),
            times_ns: Vec::new(),
            frames: Vec::new(),
            episodes: Vec::new(),
            frame: 0,
            start_ns: 0,
            times_s: Vec::new(),
            total: 0,
            stats,
        }
    }
}

impl Rows {
    /// Whether an image has the same size as the previous ones.
    pub(super) fn fits(&self, image: &RgbImage) -> bool {
        self.size.is_none_or(|size| size == (image.width, image.height))
    }

    pub(super) fn push(
        &mut self,
        time_ns: u64,
        image: &RgbImage,
        state: State,
        action: Action,
        episode: i64,
    ) -> std::io::Result<()> {
        let png = png(&image.rgb, image.width, image.height, ExtendedColorType::Rgb8)?;
        self.size = Some((image.width, image.height));
        self.stats.pixels.push(&image.rgb);
        self.images.push(ByteArray::from(png));
        self.states.extend(state);
        self.actions.extend(action);
        if self.frame == 0 {
            self.start_ns = time_ns;
        }
        self.times_ns.push(time_ns);
        self.times_s.push((time_ns - self.start_ns) as f64 * 1e-9);
        self.frames.push(self.frame);
        self.episodes.push(episode);
        self.frame += 1;
        self.total += 1;
        Ok(())
    }

    pub(super) fn begin_episode(&mut self) {
        self.frame = 0;
    }

    /// The start of the current episode in seconds of the run's clock.
    pub(super) fn start_s(&self) -> f64 {
        self.start_ns as f64 * 1e-9
    }

    pub(super) fn waiting(&self) -> usize {
        self.images.len()
    }

    pub(super) fn waiting_bytes(&self) -> u64 {
        self.images.iter().map(|image| image.len() as u64).sum()
    }

    pub(super) fn times_ns(&self) -> &[u64] {
        &self.times_ns
    }

    pub(super) fn total(&self) -> i64 {
        self.total
    }

    /// The width and height of the images.
    pub(super) fn size(&self) -> (usize, usize) {
        self.size.unwrap_or_default()
    }

    /// Passes the waiting rows to `write`, adds them to the statistics and removes them.
    pub(super) fn write(
        &mut self,
        fps: u32,
        write: impl FnOnce(&[Column<'_>]) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let timestamps: Vec<f32> =
            self.frames.iter().map(|frame| (*frame as f64 / f64::from(fps)) as f32).collect();
        let indices: Vec<i64> = (self.total - self.waiting() as i64..self.total).collect();
        let tasks = vec![0; self.waiting()];
        write(&[
            (IMAGE, Values::Images(&self.images)),
            (STATE, Values::Vectors(&self.states, 5)),
            (ACTION, Values::Vectors(&self.actions, 2)),
            (TIME, Values::Doubles(&self.times_s)),
            ("timestamp", Values::Floats(&timestamps)),
            ("frame_index", Values::Integers(&self.frames)),
            ("episode_index", Values::Integers(&self.episodes)),
            ("index", Values::Integers(&indices)),
            ("task_index", Values::Integers(&tasks)),
        ])?;
        self.stats.state.push(self.states.drain(..).map(f64::from));
        self.stats.action.push(self.actions.drain(..).map(f64::from));
        self.stats.time.push(self.times_s.drain(..));
        self.stats.timestamp.push(timestamps.into_iter().map(f64::from));
        self.stats.frame.push(as_floats(&self.frames));
        self.stats.episode.push(as_floats(&self.episodes));
        self.stats.index.push(as_floats(&indices));
        self.stats.task.push(as_floats(&tasks));
        self.images.clear();
        self.times_ns.clear();
        self.frames.clear();
        self.episodes.clear();
        Ok(())
    }

    /// The statistics of all rows that were written.
    pub(super) fn stats(&self) -> Value {
        let stats = &self.stats;
        json!({
            IMAGE: stats.pixels.json(),
            STATE: stats.state.json(),
            ACTION: stats.action.json(),
            TIME: stats.time.json(),
            "timestamp": stats.timestamp.json(),
            "frame_index": stats.frame.json(),
            "episode_index": stats.episode.json(),
            "index": stats.index.json(),
            "task_index": stats.task.json(),
        })
    }
}
