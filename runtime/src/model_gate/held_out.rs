//! Which pictures are held out: never trained on, so that the robot can judge a model by them.
//!
//! Neighbouring pictures are nearly the same, so whole places are held out, not single pictures: a bin of 1 m x 1 m and 45
//! degrees of heading, in the odometry of its run. A hash of the bin's numbers decides; it is integer arithmetic, and what comes
//! before it are three IEEE operations, so that `tools/trainer` (`held_out.py`) decides the same, picture by picture.
//!
//! What it cannot do: odometry of another run has another origin, so a place that is held out in one run may be trained on
//! from another. Pictures on both sides of a bin's edge look alike.

use std::f64::consts::TAU;

use hal::Pose2;
use serde::{Deserialize, Serialize};

/// A place and a heading, coarsely.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct PoseBin {
    /// Cell along x.
    pub x: i64,
    /// Cell along y.
    pub y: i64,
    /// Sector of the heading, from -180 degrees on.
    pub sector: i64,
}

/// Which bins are held out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeldOutRule {
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Sectors of a whole turn.
    pub sectors: i64,
    /// Of a thousand bins, so many are held out.
    pub per_mille: u64,
    /// Which ones.
    pub seed: u64,
}

impl Default for HeldOutRule {
    fn default() -> Self {
        Self { cell_m: 1.0, sectors: 8, per_mille: 100, seed: 1 }
    }
}

impl HeldOutRule {
    /// The bin of the robot's pose (`base_link` in `odom`, as recorded); `None` for a pose that is not finite.
    #[must_use]
    pub fn bin(&self, odom: &Pose2) -> Option<PoseBin> {
        let cell = |metres: f64| (metres / self.cell_m).floor() as i64;
        let sector = ((odom.yaw_rad / TAU + 0.5) * self.sectors as f64).floor() as i64;
        odom.is_finite().then(|| PoseBin {
            x: cell(odom.x_m),
            y: cell(odom.y_m),
            sector: sector.rem_euclid(self.sectors.max(1)),
        })
    }

    /// Whether pictures of this bin are held out.
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

    /// Written by the trainer's own rule: `tools/trainer/tests/test_held_out.py` reads the same file.
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
    fn robot_and_trainer_hold_out_the_same_pictures() {
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
        let held = |seed| {
            let rule = HeldOutRule { seed, ..HeldOutRule::default() };
            bins.iter().filter(|bin| rule.holds_out(bin)).copied().collect::<Vec<_>>()
        };
        let (one, two) = (held(1), held(2));
        // 12,800 bins: 1,280, three standard deviations are 102.
        assert!((1178..1382).contains(&one.len()), "{}", one.len());
        let both = one.iter().filter(|bin| two.contains(bin)).count();
        assert!(both < one.len() / 4, "{both}");
    }

    #[test]
    fn all_headings_have_a_sector_and_a_pose_that_is_not_finite_has_no_bin() {
        let rule = HeldOutRule::default();
        let sector = |yaw_rad| rule.bin(&Pose2 { x_m: 0.0, y_m: 0.0, yaw_rad }).unwrap().sector;
        assert_eq!((sector(-PI + 0.01), sector(0.0), sector(PI - 0.01), sector(PI)), (0, 4, 7, 0));
        assert_eq!(rule.bin(&Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY }), None);
    }
}
