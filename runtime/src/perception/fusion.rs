//! Memory from picture to picture: the last depth, moved by the known motion, is confirmed or contradicted by the new.

use hal::{CameraModel, Pose3};
use rayon::prelude::*;

use super::belief::Belief;
use super::sweep::nearest;
use super::trust;
use super::winner::Vote;
use crate::snapshot::remembers;

/// With less than that of a vote left, nothing is believed any more: at most 47 pictures after the last look, with the default memory.
/// No sequence with ground truth tells what older beliefs are worth.
const STALE_VOTES: f32 = 0.25;

/// What remains of the evidence when a gap takes it from a neighbour.
const GUESS: f32 = 0.9;

/// Cells of which less are not worth another thread.
pub const CELLS_AT_ONCE: usize = 512;

/// What is believed of the whole picture.
#[derive(Debug, Default)]
pub struct Memory {
    beliefs: Vec<Belief>,
    moved: Vec<Belief>,
    pose: Option<Pose3>,
}

impl Memory {
    /// Believes nothing any more.
    pub fn forget(&mut self) {
        self.pose = None;
    }

    /// Whether it is empty or of so many cells.
    pub fn has_size(&self, cells: usize) -> bool {
        self.beliefs.is_empty() || self.beliefs.len() == cells
    }

    /// Row-major.
    pub fn beliefs(&self) -> &[Belief] {
        &self.beliefs
    }

    /// Believes nothing any more of these cells, row-major.
    pub fn drop_where(&mut self, cells: &[bool]) {
        for (belief, _) in self.beliefs.iter_mut().zip(cells).filter(|(_, drop)| **drop) {
            *belief = Belief::default();
        }
    }

    /// Votes of all cells, row-major, each with the trust that `weights` put in it when jitter moves matches by `jitter_px`.
    pub fn vote(&mut self, votes: &[Vote], weights: &[f32; 5], jitter_px: f32) {
        let pairs = self.beliefs.par_iter_mut().zip(votes).with_min_len(CELLS_AT_ONCE);
        pairs.for_each(|(belief, vote)| {
            belief.vote(vote.inverse_depth, trust::of_vote(weights, vote, jitter_px));
        });
    }

    /// Moves every belief to where the camera at `pose` sees it and multiplies its evidence and its votes by `keep`. Where several meet,
    /// the nearest hides the others; what becomes stale is forgotten.
    pub fn advance(&mut self, pose: &Pose3, camera: &CameraModel, keep: f32) {
        let pixels = camera.width * camera.height;
        self.moved.clear();
        self.moved.resize(pixels, Belief::default());
        self.beliefs.resize(pixels, Belief::default());
        if let Some(before) = self.pose {
            let t_now_before = (pose.inverse() * before).to_homogeneous().cast::<f32>();
            let (fx, fy, cx, cy) =
                (camera.fx as f32, camera.fy as f32, camera.cx as f32, camera.cy as f32);
            for (index, belief) in
                self.beliefs.iter().enumerate().filter(|(_, belief)| lasts(belief, keep))
            {
                let x = ((index % camera.width) as f32 + belief.offset[0] - cx) / fx;
                let y = ((index / camera.width) as f32 + belief.offset[1] - cy) / fy;
                // The point is (x, y, 1) / w; everything is kept multiplied by w.
                let w = belief.inverse_depth;
                let row = |r: usize| {
                    t_now_before[(r, 0)] * x
                        + t_now_before[(r, 1)] * y
                        + t_now_before[(r, 2)]
                        + t_now_before[(r, 3)] * w
                };
                let z = row(2);
                let (exact_u, exact_v) = (fx * row(0) / z + cx, fy * row(1) / z + cy);
                let (u, v) = (nearest(exact_u), nearest(exact_v));
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

    /// Coming nearer tears the cells apart: one that nobody moved to, but between others, takes the farthest of them.
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

/// Whether something is believed and will be after it has aged.
fn lasts(belief: &Belief, keep: f32) -> bool {
    belief.evidence > 0.0 && belief.votes * keep >= STALE_VOTES
}

remembers!(Memory: beliefs, pose);

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: [f32; 5] = [0.0, 1.0, 0.0, 0.0, 0.0];

    #[test]
    fn agreement_adds_and_contradiction_takes_away() {
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
        let evidence = 0.5 * trust::of_vote(&WEIGHTS, &vote, 0.0);
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
    fn what_no_picture_looks_at_any_more_becomes_stale_and_is_forgotten() {
        let camera = CameraModel::pinhole(64, 16, 1.0);
        let mut memory = Memory::default();
        memory.advance(&Pose3::identity(), &camera, 0.5);
        let vote =
            Vote { inverse_depth: 0.5, margin: 0.9, texture: 0.3, misfit: 0.1, parallax_px: 9.0 };
        memory.vote(&vec![vote; 64 * 16], &WEIGHTS, 0.0);
        let mut believed = || {
            memory.advance(&Pose3::identity(), &camera, 0.5);
            memory.beliefs().iter().filter(|belief| belief.evidence > 0.0).count()
        };
        assert_eq!([believed(), believed(), believed()], [64 * 16, 64 * 16, 0]);
    }

    #[test]
    fn a_gap_between_two_surfaces_takes_the_farther_one() {
        let mut memory = Memory::default();
        let near = Belief { inverse_depth: 2.0, evidence: 1.0, votes: 1.0, offset: [0.0; 2] };
        memory.moved = vec![Belief::default(); 15];
        (memory.moved[6], memory.moved[8]) = (near, Belief { inverse_depth: 0.5, ..near });
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
