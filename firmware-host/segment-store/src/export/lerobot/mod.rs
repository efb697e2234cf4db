//! The layout of LeRobot datasets, version 3.0 (`lerobot` 0.4), with pictures as PNG inside the tables.
//!
//! LeRobot wants every frame at `frame_index / fps`, to 0.1 ms; a loop under load does not keep that. So `timestamp` is just
//! that, and the column `time_s` is when it really was, in seconds since the episode's first frame. A break longer than [`BREAK_NS`] begins
//! a new episode, so that no step of an episode hides one.

mod meta;
mod rows;
mod stats;
mod table;

use std::path::{Path, PathBuf};

use runtime::recording::{RecordedTick, SegmentHeader};
use serde_json::json;

use super::folder::new_folder;
use super::turns::each_turn;
use crate::error::BufferError;
use rows::Rows;
use table::Table;

/// The camera's RGB.
const PICTURE: &str = "observation.images.front";
/// Odometry and measured velocity.
const STATE: &str = "observation.state";
/// What the base was told, after the safety plane.
const ACTION: &str = "action";
/// Outside of `observation.`, or policies would take it for one.
const TIME: &str = "time_s";

const EPISODE_FILE: &str = "meta/episodes/chunk-000/file-000.parquet";
const TASKS_FILE: &str = "meta/tasks.parquet";

/// A new file begins behind the episode with which one becomes larger than this, LeRobot's own default.
const MAX_DATA_FILE: u64 = 100 << 20;
/// Files in a folder.
const CHUNK_FILES: i64 = 1000;
/// Frames that are in memory at once; `datasets` recommends row groups of this size for pictures.
const GROUP: usize = 100;
/// A break between two pictures that ends an episode.
const BREAK_NS: u64 = 1_000_000_000;

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ExportedEpisodes {
    /// Stretches without a break.
    pub episodes: u64,
    /// Pictures with what was known and done at their time.
    pub frames: u64,
    /// Pictures that came without odometry or a command and were left out.
    pub left_out: u64,
    /// Segments that end early; what they hold is in.
    pub cut: u64,
}

/// Where an episode is.
#[derive(Debug, Clone, Copy)]
struct Episode {
    from: i64,
    to: i64,
    chunk: i64,
    file: i64,
    start_s: f64,
}

/// Writes the run that consists of `segments`, in this order, into the new directory `to`.
///
/// # Errors
/// When `to` is there already or cannot be written, a segment is no recording of ours, or the run holds no picture with
/// odometry and a command.
pub fn lerobot(segments: &[PathBuf], to: &Path) -> Result<ExportedEpisodes, BufferError> {
    new_folder(to, |dir| {
        let mut export = Export::new(dir);
        let cut = each_turn(segments, |header, tick| export.turn(header, tick))?;
        export.exported.cut = cut;
        export.finish()
    })
}

struct Export {
    dir: PathBuf,
    header: Option<SegmentHeader>,
    rows: Rows,
    /// Known from the first row group on.
    fps: Option<u32>,
    table: Option<Table>,
    /// The table's number.
    file: i64,
    episodes: Vec<Episode>,
    last_ns: Option<u64>,
    exported: ExportedEpisodes,
}

impl Export {
    fn new(dir: &Path) -> Self {
        Self {
            dir: dir.to_owned(),
            header: None,
            rows: Rows::default(),
            fps: None,
            table: None,
            file: 0,
            episodes: Vec::new(),
            last_ns: None,
            exported: ExportedEpisodes::default(),
        }
    }

    fn turn(&mut self, header: &SegmentHeader, tick: &RecordedTick) -> Result<(), BufferError> {
        self.header.get_or_insert_with(|| header.clone());
        let Some(picture) = &tick.frame else { return Ok(()) };
        let Some((state, action)) = rows::numbers(tick).filter(|_| self.rows.fits(picture)) else {
            self.exported.left_out += 1;
            return Ok(());
        };
        let goes_on = self
            .last_ns
            .is_some_and(|last| (1..=BREAK_NS).contains(&tick.time_ns.wrapping_sub(last)));
        if !goes_on && self.last_ns.is_some() {
            self.end_episode()?;
        }
        self.last_ns = Some(tick.time_ns);
        let png = self.rows.push(tick.time_ns, picture, state, action, self.episodes.len() as i64);
        png.map_err(BufferError::write(&self.dir))?;
        if self.rows.waiting() >= GROUP { self.flush() } else { Ok(()) }
    }

    /// Writes the rows that wait.
    fn flush(&mut self) -> Result<(), BufferError> {
        if self.rows.waiting() == 0 {
            return Ok(());
        }
        let fps = *self.fps.get_or_insert_with(|| frames_per_second(self.rows.times_ns()));
        let (chunk, file) = (self.file / CHUNK_FILES, self.file % CHUNK_FILES);
        let path = self.dir.join(format!("data/chunk-{chunk:03}/file-{file:03}.parquet"));
        self.rows.write(fps, |columns| {
            let table = match &mut self.table {
                Some(table) => table,
                None => self.table.insert(Table::create(&path, columns)?),
            };
            table.append(columns)
        })
    }

    fn end_episode(&mut self) -> Result<(), BufferError> {
        let from = self.episodes.last().map_or(0, |episode| episode.to);
        let (chunk, file) = (self.file / CHUNK_FILES, self.file % CHUNK_FILES);
        self.episodes.push(Episode {
            from,
            to: self.rows.total(),
            chunk,
            file,
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

    fn close_table(&mut self) -> Result<(), BufferError> {
        self.table.take().map_or(Ok(()), Table::finish)
    }

    fn finish(mut self) -> Result<ExportedEpisodes, BufferError> {
        let Some(header) = self.header.clone().filter(|_| self.rows.total() > 0) else {
            let detail =
                "the run holds no picture with odometry and a command, so there is nothing to export".to_owned();
            return Err(BufferError::Segment { path: self.dir, detail });
        };
        self.flush()?;
        // An episode that has just ended leaves an empty one behind.
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
        // The camera, where it sits, and the configuration: LeRobot has no place for them.
        meta::write_json(&self.dir, "run.json", &json!(header.run))?;
        let (episodes, frames) = (self.episodes.len() as u64, self.rows.total() as u64);
        Ok(ExportedEpisodes { episodes, frames, ..self.exported })
    }
}

/// From the mean distance of pictures, so that nominal and real time drift apart as little as can be.
fn frames_per_second(times_ns: &[u64]) -> u32 {
    let steps =
        times_ns.windows(2).filter_map(|pair| Some(pair.get(1)?.saturating_sub(*pair.first()?)));
    let (count, sum_ns) = steps
        .filter(|step| (1..=BREAK_NS).contains(step))
        .fold((0_u64, 0_u64), |(n, sum), step| (n + 1, sum + step));
    // A single picture has no rate.
    if count == 0 { 10 } else { ((1e9 * count as f64 / sum_ns as f64).round() as u32).max(1) }
}
