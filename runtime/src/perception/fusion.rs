//! Memory from picture to picture: the last depth, moved by the known motion, is confirmed or contradicted by the new.

use hal::{CameraModel, Pose3};

use super::sweep::nearest;
use super::winner::Winner;

/// Two inverse depths agree when they differ by less than this share of the larger one: half of what delta1 allows.
const AGREEMENT: f32 = 0.12;

/// What is believed of one pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Belief {
    /// Inverse z-depth, 1/m.
    pub inverse_depth: f32,
    /// Sum of the trust in every measurement that agreed, older ones counting less; 0: nothing is believed.
    pub evidence: f32,
}

impl Belief {
    /// Lets a measurement vote: agreement adds evidence, contradiction takes it away, the stronger side stays.
    pub fn vote(&mut self, inverse_depth: f32, trust: f32) {
        if trust <= 0.0 {
            return;
        }
        let apart = (self.inverse_depth - inverse_depth).abs();
        if self.evidence > 0.0 && apart <= AGREEMENT * self.inverse_depth.max(inverse_depth) {
            self.evidence += trust;
            self.inverse_depth += (inverse_depth - self.inverse_depth) * trust / self.evidence;
        } else if trust > self.evidence {
            *self = Self { inverse_depth, evidence: trust - self.evidence };
        } else {
            self.evidence -= trust;
        }
    }

    /// Evidence as a number from 0 to 1.
    pub fn confidence(&self) -> f32 {
        self.evidence / (1.0 + self.evidence)
    }
}

/// What is believed of the half-size picture.
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

    /// Row-major.
    pub fn beliefs(&self) -> &[Belief] {
        &self.beliefs
    }

    /// Votes of all pixels, row-major: the winner and the trust in it.
    pub fn vote(&mut self, votes: &[(Winner, f32)]) {
        for (belief, (winner, trust)) in self.beliefs.iter_mut().zip(votes) {
            belief.vote(winner.inverse_depth, *trust);
        }
    }

    /// Moves every belief to where the camera at `pose` sees it and multiplies its evidence by `keep`. Where several meet,
    /// the nearest hides the others.
    pub fn advance(&mut self, pose: &Pose3, camera: &CameraModel, keep: f32) {
        let pixels = camera.width * camera.height;
        self.moved.clear();
        self.moved.resize(pixels, Belief::default());
        self.beliefs.resize(pixels, Belief::default());
        if let Some(before) = self.pose {
            let t_now_before = (pose.inverse() * before).to_homogeneous().cast::<f32>();
            let (fx, fy, cx, cy) = (camera.fx as f32, camera.fy as f32, camera.cx as f32, camera.cy as f32);
            for (index, belief) in self.beliefs.iter().enumerate().filter(|(_, belief)| belief.evidence > 0.0) {
                let x = ((index % camera.width) as f32 - cx) / fx;
                let y = ((index / camera.width) as f32 - cy) / fy;
                // The point is (x, y, 1) / w; everything is kept multiplied by w.
                let w = belief.inverse_depth;
                let row = |r: usize| {
                    t_now_before[(r, 0)] * x
                        + t_now_before[(r, 1)] * y
                        + t_now_before[(r, 2)]
                        + t_now_before[(r, 3)] * w
                };
                let z = row(2);
                let (u, v) = (nearest(fx * row(0) / z + cx), nearest(fy * row(1) / z + cy));
                let inside = u >= 0 && v >= 0 && u < camera.width as i32 && v < camera.height as i32;
                if z > 0.05 && inside {
                    let slot = &mut self.moved[v as usize * camera.width + u as usize];
                    if w / z > slot.inverse_depth {
                        *slot = Belief { inverse_depth: w / z, evidence: belief.evidence * keep };
                    }
                }
            }
        }
        std::mem::swap(&mut self.beliefs, &mut self.moved);
        self.pose = Some(*pose);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let mut votes = vec![(Winner::default(), 0.0); 64 * 16];
        // One metre to the right is 32 px / depth: the point at 2 m lands where the one at 4 m lands.
        votes[8 * 64 + 40] = (Winner { inverse_depth: 0.5, margin: 0.0 }, 1.0);
        votes[8 * 64 + 32] = (Winner { inverse_depth: 0.25, margin: 0.0 }, 1.0);
        memory.vote(&votes);
        memory.advance(&Pose3::translation(1.0, 0.0, 0.0), &camera, 0.5);
        let left: Vec<(usize, Belief)> =
            memory.beliefs().iter().copied().enumerate().filter(|(_, b)| b.evidence > 0.0).collect();
        assert_eq!(left, [(8 * 64 + 24, Belief { inverse_depth: 0.5, evidence: 0.5 })]);
    }

    #[test]
    fn a_forgotten_memory_is_empty() {
        let camera = CameraModel::pinhole(64, 16, 1.0);
        let mut memory = Memory::default();
        memory.advance(&Pose3::identity(), &camera, 1.0);
        memory.vote(&vec![(Winner { inverse_depth: 0.5, margin: 0.0 }, 1.0); 64 * 16]);
        memory.forget();
        memory.advance(&Pose3::identity(), &camera, 1.0);
        assert!(memory.beliefs().iter().all(|belief| belief.evidence == 0.0));
    }
}
