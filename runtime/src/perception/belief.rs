//! What is believed of one cell of the picture, and how votes change it.

use serde::{Deserialize, Serialize};

/// Two inverse depths agree when they differ by less than this share of the larger one: half of what delta1 allows.
pub const AGREEMENT: f32 = 0.12;

/// What is believed of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Belief {
    /// Inverse z-depth, 1/m.
    pub inverse_depth: f32,
    /// Sum of the trust in every vote that agreed less that in every one that did not, older ones counting less; 0: nothing
    /// is believed.
    pub evidence: f32,
    /// How many votes that are, older ones counting less.
    pub votes: f32,
    /// Where in its cell the thing is, cells from the middle. Motion between two pictures is a fraction of a cell: rounded
    /// every time, it would be lost.
    pub offset: [f32; 2],
}

impl Belief {
    /// Mean trust in its votes, 0 to 1; those that contradict it count against it.
    #[inline(always)]
    pub fn mean_trust(&self) -> f32 {
        self.evidence / self.votes.max(1e-6)
    }

    /// Lets a measurement vote: agreement adds evidence, contradiction takes it away, the stronger side stays.
    #[inline(always)]
    pub fn vote(&mut self, inverse_depth: f32, trust: f32) {
        if trust <= 0.0 {
            return;
        }
        let apart = (self.inverse_depth - inverse_depth).abs();
        if self.evidence > 0.0 && apart <= AGREEMENT * self.inverse_depth.max(inverse_depth) {
            self.evidence += trust;
            self.votes += 1.0;
            self.inverse_depth += (inverse_depth - self.inverse_depth) * trust / self.evidence;
        } else if trust > self.evidence {
            *self = Self {
                inverse_depth,
                evidence: trust - self.evidence,
                votes: 1.0,
                offset: [0.0; 2],
            };
        } else {
            self.evidence -= trust;
            self.votes += 1.0;
        }
    }
}
