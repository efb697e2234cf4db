//! Held-out frames: frames that no model is trained on, so that the robot can judge a model by
//! them.
//!
//! Consecutive frames are nearly the same, so whole places are held out instead of single frames:
//! bins of 1 m x 1 m and 45 degrees of heading, in the frame `map` at the exposure. A hash of the
//! bin's indices decides. The hash uses integer arithmetic and the indices take three IEEE operations,
//! so `tools/trainer` (`held_out.py`) makes the same decision for every frame.
//!
//! Limits: `map` has another origin in each run that does not begin with a saved map, so a place that
//! is held out in one run may be trained on in another run. Frames on both sides of a bin's edge look
//! alike.

use std::f64::consts::TAU;

use hal::Pose2;
use serde::{Deserialize, Serialize};

/// A bin of positions and headings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct PoseBin {
    /// Index of the cell along x.
    pub x: i64,
    /// Index of the cell along y.
    pub y: i64,
    /// Index of the heading's sector, counted from -180 degrees.
    pub sector: i64,
}

/// The rule that decides which bins are held out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeldOutRule {
    /// Edge length of a cell, metres.
    pub cell_m: f64,
    /// Number of heading sectors in 360 degrees.
    pub sectors: i64,
    /// Number of held-out bins per thousand.
    pub per_mille: u64,
    /// Seed of the hash; another seed holds out other bins.
    pub seed: u64,
}

impl Default for HeldOutRule {
    fn default() -> Self {
        Self { cell_m: 1.0, sectors: 8, per_mille: 100, seed: 1 }
    }
}

impl HeldOutRule {
    /// The bin of the robot's pose (`base_link` in `map`); `None` for a pose that is not finite.
    #[must_use]
    pub fn bin(&self, pose: &Pose2) -> Option<PoseBin> {
        let x = (pose.x_m / self.cell_m).floor() as i64;
        let y = (pose.y_m / self.cell_m).floor() as i64;
        let sector = ((pose.yaw_rad / TAU + 0.5) * self.sectors as f64).floor() as i64;
        pose.is_finite().then(|| PoseBin { x, y, sector: sector.rem_euclid(self.sectors.max(1)) })
    }

    /// Whether the frames of this bin are held out.
    #[must_use]
    pub fn holds_out(&self, bin: &PoseBin) -> bool {
        let numbers = [bin.x, bin.y, bin.sector];
        numbers.iter().fold(self.seed, |hash, number| mixed(hash ^ *number as u64)) % 1000
            < self.per_mille
    }
}

/// One step of SplitMix64 (Steele, Lea and Flood 2014).
fn mixed(state: u64) -> u64 {
    let z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Decisions of the trainer's implementation. `tools/trainer/tests/data/test_held_out.py` reads the
    /// same file.
    const SHIPPED: &str = include_str!("../../../tests/fixtures/held_out.json");

    #[derive(Deserialize)]
    struct Row {
        x_m: f64,
        y_m: f64,
        yaw_rad: f64,
        bin: [i64; 3],
        held_out: bool,
    }

    #[test]
    fn robot_and_trainer_hold_out_the_same_frames() {
        let rows: Vec<Row> = serde_json::from_str(SHIPPED).unwrap();
        let rule = HeldOutRule::default();
        for row in &rows {
            let bin =
                rule.bin(&Pose2 { x_m: row.x_m, y_m: row.y_m, yaw_rad: row.yaw_rad }).unwrap();
            assert_eq!(
                [bin.x, bin.y, bin.sector],
                row.bin,
                "{} {} {}",
                row.x_m,
                row.y_m,
                row.yaw_rad
            );
            assert_eq!(rule.holds_out(&bin), row.held_out, "{bin:?}");
        }
        assert!(rows.len() >= 500 && rows.iter().filter(|row| row.held_out).count() > 20);
    }

    #[test]
    fn about_a_tenth_of_all_bins_is_held_out_and_a_seed_changes_which() {
        let bins: Vec<PoseBin> = (-20..20)
            .flat_map(|x| {
                (-20..20).flat_map(move |y| (0..8).map(move |sector| PoseBin { x, y, sector }))
            })
            .collect();
        let [one, two] = [1, 2].map(|seed| {
            let rule = HeldOutRule { seed, ..HeldOutRule::default() };
            bins.iter().filter(|bin| rule.holds_out(bin)).copied().collect::<Vec<_>>()
        });
        // 1,280 of the 12,800 bins are expected; three standard deviations are 102.
        assert!((1178..1382).contains(&one.len()), "{}", one.len());
        let both = one.iter().filter(|bin| two.contains(bin)).count();
        assert!(both < one.len() / 4, "{both}");
    }

    #[test]
    fn all_headings_have_a_sector_and_a_pose_that_is_not_finite_has_no_bin() {
        let rule = HeldOutRule::default();
        let sectors = [-PI + 0.01, 0.0, PI - 0.01, PI]
            .map(|yaw_rad| rule.bin(&Pose2 { x_m: 0.0, y_m: 0.0, yaw_rad }).unwrap().sector);
        assert_eq!(sectors, [0, 4, 7, 0]);
        assert_eq!(rule.bin(&Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY }), None);
    }
}
