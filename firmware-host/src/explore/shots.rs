//! Images of a run, spread evenly over it, for the animation.

use std::path::Path;

use runtime::robot::Robot;
use runtime::tick::TickInput;
use simulator::floor::FloorPlan;

use super::map_plot::resampled;
use crate::evaluation::Evaluation;
use crate::report::animation::{Animation, SHOTS, Shot};
use crate::report::atomic::ReportError;
use crate::report::coverage::Coverage;
use crate::report::depth_sample::{FrameDepths, SheetRow};
use crate::report::depth_scale::DepthScale;

/// The images so far.
pub(super) struct Shots {
    /// Frames from one image to the next.
    every: u64,
    /// The last frame of the run is always an image.
    last: u64,
    map_width: usize,
    shots: Vec<Shot>,
}

impl Shots {
    /// A collection without images, for a run of `frames` frames.
    pub fn of(frames: u64) -> Self {
        Self {
            every: frames.div_ceil(SHOTS),
            last: frames.saturating_sub(1),
            map_width: 0,
            shots: Vec::new(),
        }
    }

    /// Stores an image of the current frame if one is due.
    pub fn offer(
        &mut self,
        input: &TickInput<'_>,
        robot: &Robot,
        evaluation: &Evaluation,
        plan: &FloorPlan,
    ) {
        let due = input.tick.is_multiple_of(self.every) || input.tick == self.last;
        let Some(frame) = input.frame.as_ref().filter(|_| due) else { return };
        let row = SheetRow::capture(input.tick, frame, &FrameDepths::of(robot));
        let (width, cells) = resampled(robot.map(), &evaluation.t_world_map(), plan.grid());
        self.map_width = width;
        let coverage = evaluation.coverage().map(Coverage::share);
        self.shots.extend(row.map(|row| Shot { row, cells, coverage }));
    }

    /// Writes the animation of the collected images.
    pub fn write(
        &self,
        title: &str,
        scale: DepthScale,
        cell_m: f64,
        evaluation: &Evaluation,
        plan: &FloorPlan,
        out: &Path,
    ) -> Result<(), ReportError> {
        Animation {
            title,
            shots: &self.shots,
            map_width: self.map_width,
            resolution_m: cell_m,
            trajectory: &evaluation.believed_path(),
            origin_m: plan.grid().origin_m,
            scale,
        }
        .write(out)
    }
}
