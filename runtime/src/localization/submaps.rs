//! The surfaces that the robot has seen, in pieces of a metre or two that are rigid and move as a whole.

use hal::Pose2;
use serde::{Deserialize, Serialize};

use crate::snapshot::remembers;

use super::scan_points::Stretch;
use super::surfel_grid::SurfelGrid;

/// A submap is finished when the robot is this far from where the submap began, or after this many keyframes.
const LENGTH_M: f64 = 0.8;
const KEYFRAMES: usize = 8;
/// Bounds memory to 40 MiB: a path of three kilometres. The last submap then goes on without end.
pub(crate) const MAX_SUBMAPS: usize = 4096;
/// Stretches of one submap at most: those of the first scans stay.
const MAX_STRETCHES: usize = 500;

/// A piece of the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Submap {
    /// Where it began. Stretches are in this frame.
    pub t_odom: Pose2,
    /// Number of the first of its keyframes.
    pub keyframe: u32,
    /// Merged from its keyframes; empty until it is finished.
    pub stretches: Vec<Stretch>,
}

/// All submaps. The last one is being made.
pub(crate) struct Submaps {
    submaps: Vec<Submap>,
    /// The keyframes of the last submap.
    current: Vec<(Pose2, Vec<Stretch>)>,
    keyframes: u32,
    /// Memory of earlier keyframes.
    spare: Vec<Vec<Stretch>>,
    /// Merges surfaces. Every submap overwrites it.
    grid: SurfelGrid,
}

remembers!(Submaps: submaps, current, keyframes);

impl Submaps {
    pub(crate) fn new() -> Self {
        let grid = SurfelGrid::new(0.1);
        let spare = Vec::with_capacity(KEYFRAMES);
        Self { submaps: Vec::new(), current: Vec::new(), keyframes: 0, spare, grid }
    }

    pub(crate) fn all(&self) -> &[Submap] {
        &self.submaps
    }

    /// Whether a keyframe at this pose in `odom` begins a new submap.
    pub(crate) fn is_due(&self, pose: &Pose2) -> bool {
        self.submaps.last().is_none_or(|last| {
            self.submaps.len() < MAX_SUBMAPS
                && (self.current.len() >= KEYFRAMES || last.t_odom.distance_m(pose) > LENGTH_M)
        })
    }

    /// Finishes the last submap and begins a new one at a pose in `odom`.
    pub(crate) fn begin(&mut self, pose: &Pose2) {
        self.finish();
        let keyframe = self.keyframes;
        self.submaps.push(Submap { t_odom: *pose, keyframe, stretches: Vec::new() });
    }

    /// Adds a keyframe to the last submap.
    pub(crate) fn add(&mut self, pose: &Pose2, stretches: &[Stretch]) {
        self.keyframes += 1;
        if self.current.len() < KEYFRAMES {
            let mut kept = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(MAX_STRETCHES));
            kept.extend_from_slice(stretches);
            self.current.push((*pose, kept));
        }
    }

    /// Merges the keyframes of the last submap, which gets no more.
    pub(crate) fn finish(&mut self) {
        let Some(last) = self.submaps.last_mut() else { return };
        let to_submap = last.t_odom.inverse();
        self.grid.clear([0.0; 2]);
        for (pose, stretches) in &self.current {
            self.grid.insert(stretches, &to_submap.compose(pose));
        }
        last.stretches.extend(self.grid.stretches().take(MAX_STRETCHES));
        for (_, mut stretches) in self.current.drain(..) {
            stretches.clear();
            self.spare.push(stretches);
        }
    }
}
