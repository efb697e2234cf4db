//! The accumulated depth of one cell, and how votes change it.

use serde::{Deserialize, Serialize};

/// Two inverse depths agree when they differ by less than this share of the larger one: half of the delta1 tolerance.
pub const AGREEMENT: f32 = 0.12;

/// The depth of one cell as accumulated from votes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Belief {
    /// Inverse z-depth, 1/m.
    pub inverse_depth: f32,
    /// Sum of the confidence of the votes that agreed, less that of the votes that did not; older votes count less. 0: the cell
    /// has no belief.
    pub evidence: f32,
    /// Number of these votes; older ones count less.
    pub votes: f32,
    /// Position of the surface point in its cell, in cells from the middle. Motion between two frames is a fraction of a cell
    /// and would be lost if it were rounded every time.
    pub offset: [f32; 2],
}

impl Belief {
    /// Mean confidence of its votes, 0 to 1; contradicting votes count against it.
    #[inline(always)]
    pub fn mean_confidence(&self) -> f32 {
        self.evidence / self.votes.max(1e-6)
    }

    /// Adds a vote: agreement adds evidence, contradiction removes it, and the stronger side stays.
    #[inline(always)]
    pub fn vote(&mut self, inverse_depth: f32, confidence: f32) {
        if confidence <= 0.0 {
            return;
        }
        let apart = (self.inverse_depth - inverse_depth).abs();
        if self.evidence > 0.0 && apart <= AGREEMENT * self.inverse_depth.max(inverse_depth) {
            self.evidence += confidence;
            self.votes += 1.0;
            self.inverse_depth += (inverse_depth - self.inverse_depth) * confidence / self.evidence;
        } else if confidence > self.evidence {
            *self = Self {
                inverse_depth,
                evidence: confidence - self.evidence,
                votes: 1.0,
                offset: [0.0; 2],
            };
        } else {
            self.evidence -= confidence;
            self.votes += 1.0;
        }
    }
}
