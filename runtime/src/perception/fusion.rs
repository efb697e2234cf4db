//! Temporal fusion: beliefs are moved by the known motion, and confirmed or contradicted by the votes of the new frame.

use hal::{CameraModel, Pose3};
use rayon::prelude::*;

use super::belief::Belief;
use super::confidence;
use super::sweep::nearest;
use super::wta::Vote;
use crate::snapshot::remembers;

/// A belief with fewer votes than this is removed: with the default memory, at most 47 frames after its last vote. No
/// sequence with ground truth shows the accuracy of older beliefs.
const STALE_VOTES: f32 = 0.25;

/// Factor on the evidence of a belief that is copied into a gap.
const GUESS: f32 = 0.9;

/// Minimum number of cells for one task: with fewer, another thread saves nothing.
pub const CELLS_AT_ONCE: usize = 512;

/// The beliefs of all cells.
#[derive(Debug, Default)]
pub struct Memory {
    beliefs: Vec<Belief>,
    moved: Vec<Belief>,
    pose: Option<Pose3>,
}

impl Memory {
    /// Removes all beliefs at the next [`advance`](Self::advance).
    pub fn forget(&mut self) {
        self.pose = None;
    }

    /// Whether it is empty or has this number of cells.
    pub fn has_size(&self, cells: usize) -> bool {
        self.beliefs.is_empty() || self.beliefs.len() == cells
    }

    /// The beliefs of all cells, row-major.
    pub fn beliefs(&self) -> &[Belief] {
        &self.beliefs
    }

    /// Removes the beliefs of the cells that are marked, row-major.
    pub fn drop_where(&mut self, cells: &[bool]) {
        for (belief, _) in self.beliefs.iter_mut().zip(cells).filter(|(_, drop)| **drop) {
            *belief = Belief::default();
        }
    }

    /// Adds the votes of all cells, row-major. Their confidence follows from `weights` and the displacement of matches by
    /// jitter.
    pub fn vote(&mut self, votes: &[Vote], weights: &[f32; 5], jitter_px: f32) {
        let pairs = self.beliefs.par_iter_mut().zip(votes).with_min_len(CELLS_AT_ONCE);
        pairs.for_each(|(belief, vote)| {
            belief.vote(vote.inverse_depth, confidence::of_vote(weights, vote, jitter_px));
        });
    }

    /// Moves every belief to the cell where the camera at `pose` sees it, and multiplies its evidence and its votes by
    /// `keep`. Where several meet, the nearest hides the others; stale beliefs are removed.
    pub fn advance(&mut self, pose: &Pose3, camera: &CameraModel, keep: f32) {
        let pixels = camera.width * camera.height;
        self.moved.clear();
        self.moved.resize(pixels, Belief::default());
        self.beliefs.resize(pixels, Belief::default());
        if let Some(before) = self.pose {
            let t_now_before = (pose.inverse() * before).to_homogeneous().cast::<f32>();
            let fx = camera.fx as f32;
            let fy = camera.fy as f32;
            let cx = camera.cx as f32;
            let cy = camera.cy as f32;
            for (index, belief) in
                self.beliefs.iter().enumerate().filter(|(_, belief)| lasts(belief, keep))
            {
                let x = ((index % camera.width) as f32 + belief.offset[0] - cx) / fx;
                let y = ((index / camera.width) as f32 + belief.offset[1] - cy) / fy;
                // The point is (x, y, 1) / w; everything is kept multiplied by w.
                let w = belief.inverse_depth;
                let [moved_x, moved_y, z] = [0, 1, 2].map(|row| {
                    t_now_before[(row, 0)] * x
                        + t_now_before[(row, 1)] * y
                        + t_now_before[(row, 2)]
                        + t_now_before[(row, 3)] * w
                });
                let exact_u = fx * moved_x / z + cx;
                let exact_v = fy * moved_y / z + cy;
                let u = nearest(exact_u);
                let v = nearest(exact_v);
                let inside =
                    u >= 0 && v >= 0 && u < camera.width as i32 && v < camera.height as i32;
                if z > 0.05 && inside {
                    let slot = &mut self.moved[v as usize * camera.width + u as usize];
                    if w / z > slot.inverse_depth {
                        let offset = [exact_u - u as f32, exact_v - v as f32];
                        *slot = Belief {
                            inverse_depth: w / z,
                            evidence: belief.evidence * keep,
                            votes: belief.votes * keep,
                            offset,
                        };
                    }
                }
            }
        }
        self.close_gaps(camera.width);
        std::mem::swap(&mut self.beliefs, &mut self.moved);
        self.pose = Some(*pose);
    }

    /// Driving forward spreads the cells and leaves gaps: an empty cell with at least two known neighbours takes the farthest
    /// of them.
    fn close_gaps(&mut self, width: usize) {
        self.beliefs.copy_from_slice(&self.moved);
        let last = self.moved.len().saturating_sub(width);
        for at in width..last {
            if self.beliefs[at].evidence > 0.0 {
                continue;
            }
            let around = [at - 1, at + 1, at - width, at + width].map(|index| self.beliefs[index]);
            let known = around.iter().filter(|belief| belief.evidence > 0.0);
            if known.clone().count() < 2 {
                continue;
            }
            if let Some(farthest) = known.min_by(|a, b| a.inverse_depth.total_cmp(&b.inverse_depth))
            {
                self.moved[at] =
                    Belief { offset: [0.0; 2], evidence: farthest.evidence * GUESS, ..*farthest };
            }
        }
    }
}

/// Whether a belief exists and has enough votes after ageing.
fn lasts(belief: &Belief, keep: f32) -> bool {
    belief.evidence > 0.0 && belief.votes * keep >= STALE_VOTES
}

remembers!(Memory: beliefs, pose);

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: [f32; 5] = [0.0, 1.0, 0.0, 0.0, 0.0];

    #[test]
    fn agreement_adds_evidence_and_contradiction_removes_it() {
        let mut belief = Belief::default();
        belief.vote(0.5, 0.4);
        belief.vote(0.52, 0.4);
        assert!((belief.evidence - 0.8).abs() < 1e-6 && (belief.inverse_depth - 0.51).abs() < 1e-6);
        belief.vote(1.0, 0.3);
        assert!((belief.evidence - 0.5).abs() < 1e-6 && (belief.inverse_depth - 0.51).abs() < 1e-6);
        belief.vote(1.0, 0.7);
        assert!((belief.evidence - 0.2).abs() < 1e-6 && belief.inverse_depth == 1.0);
    }

    #[test]
    fn beliefs_move_with_the_camera_and_near_hides_far() {
        let camera = CameraModel::pinhole(64, 16, std::f64::consts::FRAC_PI_2);
        let mut memory = Memory::default();
        memory.advance(&Pose3::identity(), &camera, 1.0);
        let mut votes = vec![Vote::default(); 64 * 16];
        // One metre to the right is 32 px / depth: the point at 2 m lands where the one at 4 m lands.
        let vote =
            Vote { inverse_depth: 0.5, margin: 0.5, texture: 0.3, misfit: 0.1, parallax_px: 9.0 };
        votes[8 * 64 + 40] = vote;
        votes[8 * 64 + 32] = Vote { inverse_depth: 0.25, ..vote };
        memory.vote(&votes, &WEIGHTS, 0.0);
        memory.advance(&Pose3::translation(1.0, 0.0, 0.0), &camera, 0.5);
        let left: Vec<(usize, Belief)> = memory
            .beliefs()
            .iter()
            .copied()
            .enumerate()
            .filter(|(_, b)| b.evidence > 0.0)
            .collect();
        let evidence = 0.5 * confidence::of_vote(&WEIGHTS, &vote, 0.0);
        assert_eq!(
            left,
            [(8 * 64 + 24, Belief { inverse_depth: 0.5, evidence, votes: 0.5, offset: [0.0; 2] })]
        );
    }

    #[test]
    fn motion_of_a_third_of_a_cell_is_not_lost() {
        let camera = CameraModel::pinhole(64, 16, std::f64::consts::FRAC_PI_2);
        let mut memory = Memory::default();
        memory.advance(&Pose3::identity(), &camera, 1.0);
        let mut votes = vec![Vote::default(); 64 * 16];
        votes[8 * 64 + 40] =
            Vote { inverse_depth: 0.5, margin: 0.5, texture: 0.3, misfit: 0.1, parallax_px: 9.0 };
        memory.vote(&votes, &WEIGHTS, 0.0);
        // 32 px / 2 m * (1/48) m = 1/3 px a step.
        for step in 1..=6 {
            memory.advance(&Pose3::translation(f64::from(step) / 48.0, 0.0, 0.0), &camera, 1.0);
        }
        let place = memory.beliefs().iter().position(|belief| belief.evidence > 0.0).unwrap();
        assert_eq!(place, 8 * 64 + 38);
    }

    #[test]
    fn a_belief_without_further_votes_becomes_stale_and_is_removed() {
        let camera = CameraModel::pinhole(64, 16, 1.0);
        let mut memory = Memory::default();
        memory.advance(&Pose3::identity(), &camera, 0.5);
        let vote =
            Vote { inverse_depth: 0.5, margin: 0.9, texture: 0.3, misfit: 0.1, parallax_px: 9.0 };
        memory.vote(&vec![vote; 64 * 16], &WEIGHTS, 0.0);
        let believed = [(); 3].map(|()| {
            memory.advance(&Pose3::identity(), &camera, 0.5);
            memory.beliefs().iter().filter(|belief| belief.evidence > 0.0).count()
        });
        assert_eq!(believed, [64 * 16, 64 * 16, 0]);
    }

    #[test]
    fn a_gap_between_two_surfaces_takes_the_farther_one() {
        let mut memory = Memory::default();
        let near = Belief { inverse_depth: 2.0, evidence: 1.0, votes: 1.0, offset: [0.0; 2] };
        memory.moved = vec![Belief::default(); 15];
        memory.moved[6] = near;
        memory.moved[8] = Belief { inverse_depth: 0.5, ..near };
        memory.beliefs = memory.moved.clone();
        memory.close_gaps(5);
        assert_eq!((memory.moved[7].inverse_depth, memory.moved[7].evidence), (0.5, GUESS));
        assert_eq!(memory.moved[1], Belief::default());
    }

    #[test]
    fn a_forgotten_memory_is_empty() {
        let camera = CameraModel::pinhole(64, 16, 1.0);
        let mut memory = Memory::default();
        memory.advance(&Pose3::identity(), &camera, 1.0);
        let vote =
            Vote { inverse_depth: 0.5, margin: 0.5, texture: 0.3, misfit: 0.1, parallax_px: 9.0 };
        memory.vote(&vec![vote; 64 * 16], &WEIGHTS, 0.0);
        memory.forget();
        memory.advance(&Pose3::identity(), &camera, 1.0);
        assert!(memory.beliefs().iter().all(|belief| belief.evidence == 0.0));
    }
}
