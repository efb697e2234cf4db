//! Export as a LeRobot dataset, format version 3.0 (`lerobot` 0.4), with images as PNG inside the tables.
//!
//! LeRobot requires every frame at `frame_index / fps` to 0.1 ms, which a control loop under load does not keep. The column
//! `timestamp` is therefore exactly `frame_index / fps`, and the column `time_s` is the real time in seconds since the first frame
//! of the episode. A gap longer than [`BREAK_NS`] starts a new episode, so that no step within an episode spans a gap.
//!
//! `action` is the command that was sent to the base: what left the safety loop, not what the planner desired. The safety loop sends
//! about ten commands from one tick to the next; the action of a frame is the one that was in force when the next tick began. A frame
//! without a next tick, at the end of a run or before a gap, is left out.

mod layout;
mod meta;
mod rows;
mod stats;
mod table;

use std::path::{Path, PathBuf};

use runtime::recording::{RecordedTick, RgbImage, SegmentHeader};
use serde_json::json;

use super::folder::new_folder;
use super::ticks::{check_order, each_tick, shown};
use crate::error::StoreError;
use layout::{BREAK_NS, CHUNK_FILES, Episode, MAX_DATA_FILE, ROW_GROUP};
use rows::{Action, Rows, State};
use table::Table;

/// The counts of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LerobotSummary {
    /// The number of episodes: spans of the run without a gap.
    pub episodes: u64,
    /// The number of frames: images with the state and the action at their time.
    pub frames: u64,
    /// The number of images that were left out because their tick has no pose, or no tick follows that holds their command.
    pub left_out: u64,
    /// The number of segments that end early; their complete ticks are exported.
    pub cut: u64,
}

/// Exports the run that consists of `segments`, in this order, into the new directory `to`.
///
/// # Errors
/// When `to` exists already or cannot be written, a segment is not a recording, the segments are out of order, or the run contains
/// no image with a pose and a command.
pub fn lerobot(segments: &[PathBuf], to: &Path) -> Result<LerobotSummary, StoreError> {
    check_order(segments)?;
    new_folder(to, |dir| {
        let mut export = Export::new(dir, shown(segments));
        let cut = each_tick(segments, |header, tick| export.tick(header, tick))?;
        export.exported.cut = cut;
        export.finish()
    })
}

struct Export {
    dir: PathBuf,
    /// What errors about the recording call it.
    run: PathBuf,
    header: Option<SegmentHeader>,
    rows: Rows,
    /// Computed from the first row group.
    fps: Option<u32>,
    table: Option<Table>,
    /// The number of the data file.
    file: i64,
    episodes: Vec<Episode>,
    last_ns: Option<u64>,
    /// The newest frame, whose action the next tick brings.
    waiting: Option<Waiting>,
    exported: LerobotSummary,
}

/// A frame without its action.
struct Waiting {
    tick: u64,
    time_ns: u64,
    image: RgbImage,
    state: State,
}

impl Export {
    fn new(dir: &Path, run: PathBuf) -> Self {
        Self {
            dir: dir.to_owned(),
            run,
            header: None,
            rows: Rows::default(),
            fps: None,
            table: None,
            file: 0,
            episodes: Vec::new(),
            last_ns: None,
            waiting: None,
            exported: LerobotSummary::default(),
        }
    }

    fn tick(&mut self, header: &SegmentHeader, tick: &RecordedTick) -> Result<(), StoreError> {
        self.header.get_or_insert_with(|| header.clone());
        if let Some(waiting) = self.waiting.take() {
            let elapsed_ns = tick.time_ns.wrapping_sub(waiting.time_ns);
            let is_next = tick.tick == waiting.tick + 1 && (1..=BREAK_NS).contains(&elapsed_ns);
            let action = rows::action_before(tick).filter(|_| is_next);
            match action {
                Some(action) => self.push(&waiting, action)?,
                None => self.exported.left_out += 1,
            }
        }
        let Some(image) = &tick.frame else { return Ok(()) };
        match rows::state(tick).filter(|_| self.rows.fits(image)) {
            Some(state) => {
                let image = image.clone();
                let time_ns = tick.time_ns;
                self.waiting = Some(Waiting { tick: tick.tick, time_ns, image, state });
            }
            None => self.exported.left_out += 1,
        }
        Ok(())
    }

    fn push(&mut self, frame: &Waiting, action: Action) -> Result<(), StoreError> {
        let is_gap = self
            .last_ns
            .is_some_and(|last| !(1..=BREAK_NS).contains(&frame.time_ns.wrapping_sub(last)));
        if is_gap {
            self.end_episode()?;
        }
        self.last_ns = Some(frame.time_ns);
        let episode = self.episodes.len() as i64;
        self.rows
            .push(frame.time_ns, &frame.image, frame.state, action, episode)
            .map_err(StoreError::output(&self.dir))?;
        if self.rows.waiting() >= ROW_GROUP { self.flush() } else { Ok(()) }
    }

    /// Writes the collected rows as a row group.
    fn flush(&mut self) -> Result<(), StoreError> {
        if self.rows.waiting() == 0 {
            return Ok(());
        }
        let fps = *self.fps.get_or_insert_with(|| frames_per_second(self.rows.times_ns()));
        let chunk = self.file / CHUNK_FILES;
        let file = self.file % CHUNK_FILES;
        let path = self.dir.join(format!("data/chunk-{chunk:03}/file-{file:03}.parquet"));
        self.rows.write(fps, |columns| {
            let table = match &mut self.table {
                Some(table) => table,
                None => self.table.insert(Table::create(&path, columns)?),
            };
            table.append(columns)
        })
    }

    fn end_episode(&mut self) -> Result<(), StoreError> {
        let from = self.episodes.last().map_or(0, |episode| episode.to);
        self.episodes.push(Episode {
            from,
            to: self.rows.total(),
            chunk: self.file / CHUNK_FILES,
            file: self.file % CHUNK_FILES,
            start_s: self.rows.start_s(),
        });
        self.rows.begin_episode();
        if self
            .table
            .as_ref()
            .is_some_and(|table| table.bytes() + self.rows.waiting_bytes() > MAX_DATA_FILE)
        {
            self.flush()?;
            self.close_table()?;
            self.file += 1;
        }
        Ok(())
    }

    fn close_table(&mut self) -> Result<(), StoreError> {
        self.table.take().map_or(Ok(()), Table::finish)
    }

    fn finish(mut self) -> Result<LerobotSummary, StoreError> {
        self.exported.left_out += u64::from(self.waiting.take().is_some());
        let Some(header) = self.header.clone().filter(|_| self.rows.total() > 0) else {
            let detail =
                "the run contains no image with a pose and a command, so there is nothing to export"
                    .to_owned();
            return Err(StoreError::Segment { path: self.run, detail });
        };
        self.flush()?;
        // Flushed before, because rows of the last episode are still waiting.
        self.end_episode()?;
        self.close_table()?;
        let (width, height) = self.rows.size();
        let info = meta::Info {
            episodes: self.episodes.len(),
            frames: self.rows.total(),
            fps: self.fps.unwrap_or(1),
            width,
            height,
        };
        let task = format!("explore a home by the policy {}", header.run.policy);
        meta::write_episodes(&self.dir, &self.episodes, &task)?;
        meta::write_tasks(&self.dir, &task)?;
        meta::write_json(&self.dir, "info.json", &info.json())?;
        meta::write_json(&self.dir, "stats.json", &self.rows.stats())?;
        // The camera model, its mounting pose and the configuration, for which LeRobot has no fields.
        meta::write_json(&self.dir, "run.json", &json!(header.run))?;
        Ok(LerobotSummary {
            episodes: self.episodes.len() as u64,
            frames: self.rows.total() as u64,
            ..self.exported
        })
    }
}

/// The frame rate, from the mean time between images, so that nominal and real time diverge as little as possible.
fn frames_per_second(times_ns: &[u64]) -> u32 {
    let steps =
        times_ns.windows(2).filter_map(|pair| Some(pair.get(1)?.saturating_sub(*pair.first()?)));
    let (count, sum_ns) = steps
        .filter(|step| (1..=BREAK_NS).contains(step))
        .fold((0_u64, 0_u64), |(n, sum), step| (n + 1, sum + step));
    // A single image has no rate.
    if count == 0 { 10 } else { ((1e9 * count as f64 / sum_ns as f64).round() as u32).max(1) }
}
