//! Rows of the data tables, collected to be written as columns.

use parquet::data_type::ByteArray;
use runtime::recording::{Picture, RecordedTick};
use serde_json::{Value, json};

use super::stats::{Numbers, Pixels};
use super::table::{Column, Values};
use super::{ACTION, PICTURE, STATE, TIME};
use crate::error::BufferError;
use crate::export::turns::png;

/// x, y, yaw, forward speed, turn rate.
type State = [f32; 5];
/// Forward speed, turn rate.
type Action = [f32; 2];

/// What the robot knew and did, if it did.
pub(super) fn numbers(tick: &RecordedTick) -> Option<(State, Action)> {
    let (odom, twist) = (&tick.wheel.odom, &tick.wheel.twist);
    let command = tick.decision.as_ref()?.sent?;
    let state = [odom.x_m, odom.y_m, odom.yaw_rad, twist.linear_mps, twist.angular_radps]
        .map(|value| value as f32);
    let action = [command.linear_mps, command.angular_radps].map(|value| value as f32);
    state.iter().chain(&action).all(|value| value.is_finite()).then_some((state, action))
}

/// Rows that wait, and the statistics of all.
pub(super) struct Rows {
    size: Option<(usize, usize)>,
    pictures: Vec<ByteArray>,
    states: Vec<f32>,
    actions: Vec<f32>,
    times_ns: Vec<u64>,
    frames: Vec<i64>,
    episodes: Vec<i64>,
    /// The next row's number in its episode.
    frame: i64,
    /// When the episode began.
    start_ns: u64,
    /// Seconds since then, of the rows that wait.
    times_s: Vec<f64>,
    /// Rows so far, with those that wait.
    total: i64,
    stats: Stats,
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
        let one = || Numbers::new(1);
        let stats = Stats {
            pixels: Pixels::default(),
            state: Numbers::new(5),
            action: Numbers::new(2),
            time: one(),
            timestamp: one(),
            frame: one(),
            episode: one(),
            index: one(),
            task: one(),
        };
        Self {
            size: None,
            pictures: Vec::new(),
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
    /// Whether a picture has the size of the others.
    pub(super) fn fits(&self, picture: &Picture) -> bool {
        self.size.is_none_or(|size| size == (picture.width, picture.height))
    }

    pub(super) fn push(
        &mut self,
        time_ns: u64,
        picture: &Picture,
        state: State,
        action: Action,
        episode: i64,
    ) -> std::io::Result<()> {
        let png = png(&picture.rgb, picture.width, picture.height, image::ExtendedColorType::Rgb8)?;
        self.size = Some((picture.width, picture.height));
        self.stats.pixels.push(&picture.rgb);
        self.pictures.push(ByteArray::from(png));
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

    /// When the episode began, in seconds of the run's clock.
    pub(super) fn start_s(&self) -> f64 {
        self.start_ns as f64 * 1e-9
    }

    pub(super) fn waiting(&self) -> usize {
        self.pictures.len()
    }

    pub(super) fn waiting_bytes(&self) -> u64 {
        self.pictures.iter().map(|picture| picture.len() as u64).sum()
    }

    pub(super) fn times_ns(&self) -> &[u64] {
        &self.times_ns
    }

    pub(super) fn total(&self) -> i64 {
        self.total
    }

    /// Width and height.
    pub(super) fn size(&self) -> (usize, usize) {
        self.size.unwrap_or_default()
    }

    /// Hands the rows that wait to `write` and forgets them.
    pub(super) fn write(
        &mut self,
        fps: u32,
        write: impl FnOnce(&[Column<'_>]) -> Result<(), BufferError>,
    ) -> Result<(), BufferError> {
        let timestamps: Vec<f32> =
            self.frames.iter().map(|frame| (*frame as f64 / f64::from(fps)) as f32).collect();
        let indices: Vec<i64> = (self.total - self.waiting() as i64..self.total).collect();
        let tasks = vec![0; self.waiting()];
        write(&[
            (PICTURE, Values::Pictures(&self.pictures)),
            (STATE, Values::Vectors(&self.states, 5)),
            (ACTION, Values::Vectors(&self.actions, 2)),
            (TIME, Values::Doubles(&self.times_s)),
            ("timestamp", Values::Floats(&timestamps)),
            ("frame_index", Values::Integers(&self.frames)),
            ("episode_index", Values::Integers(&self.episodes)),
            ("index", Values::Integers(&indices)),
            ("task_index", Values::Integers(&tasks)),
        ])?;
        let integers =
            |values: &[i64]| values.iter().map(|value| *value as f64).collect::<Vec<_>>();
        self.stats.state.push(self.states.drain(..).map(f64::from));
        self.stats.action.push(self.actions.drain(..).map(f64::from));
        self.stats.time.push(self.times_s.drain(..));
        self.stats.timestamp.push(timestamps.into_iter().map(f64::from));
        self.stats.frame.push(integers(&self.frames));
        self.stats.episode.push(integers(&self.episodes));
        self.stats.index.push(integers(&indices));
        self.stats.task.push(integers(&tasks));
        self.pictures.clear();
        self.times_ns.clear();
        self.frames.clear();
        self.episodes.clear();
        Ok(())
    }

    /// Of everything that was written.
    pub(super) fn stats(&self) -> Value {
        let stats = &self.stats;
        json!({
            PICTURE: stats.pixels.json(),
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
