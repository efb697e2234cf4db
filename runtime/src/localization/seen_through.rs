//! Where one of a scan and a map has seen through what the other shows: evidence that the scan was not taken there.
//!
//! A scan lies on the walls of many rooms of a similar size. A wall that stands in the map between the scanner and what it has
//! hit distinguishes them, and so does a thing that the scan shows where the map was seen through.

use hal::Pose2;

use super::scan_points::Stretch;
use super::surfel_grid::SurfelGrid;

/// Directions that are distinguished.
const SECTORS: usize = 360;
/// Surfaces further away are hit by few beams, metres.
const MAX_RANGE_M: f32 = 8.0;
/// Nearer ones are parts of people and of the robot.
const MIN_RANGE_M: f32 = 0.3;
/// A surface this far in front of what the scan has hit was seen through, metres: more than the error of a found pose.
const DEPTH_M: f32 = 0.3;
/// Surfaces that are seen at less than 20 degrees are hit by chance.
const MIN_INCIDENCE: f32 = 0.35;
/// Half the length of a stretch, metres.
const HALF_STRETCH_M: f32 = 0.05;

/// The nearest hit of a scan in every direction around the scanner.
pub(crate) struct Sight {
    t_base_laser: Pose2,
    /// Infinite where nothing was hit.
    ranges: [f32; SECTORS],
}

impl Sight {
    /// What a scan saw, from its stretches in the robot's frame.
    pub(crate) fn new(stretches: &[Stretch], t_base_laser: &Pose2) -> Self {
        let mut ranges = [f32::INFINITY; SECTORS];
        let [x, y] = [t_base_laser.x_m, t_base_laser.y_m].map(|value| value as f32);
        for stretch in stretches {
            let dx = stretch.x - x;
            let dy = stretch.y - y;
            let range_m = dx.hypot(dy);
            let middle = dy.atan2(dx);
            let half = HALF_STRETCH_M.atan2(range_m);
            let [first, last] = [middle - half, middle + half].map(sector);
            for sector in first..=last {
                let range = &mut ranges[sector.rem_euclid(SECTORS as i32) as usize];
                *range = range.min(range_m);
            }
        }
        Self { t_base_laser: *t_base_laser, ranges }
    }

    /// Whether a point in the robot's frame lies well in front of what was hit in its direction.
    pub(crate) fn is_through(&self, x: f32, y: f32) -> bool {
        let dx = x - self.t_base_laser.x_m as f32;
        let dy = y - self.t_base_laser.y_m as f32;
        let hit_m = self.ranges[sector(dy.atan2(dx)).rem_euclid(SECTORS as i32) as usize];
        hit_m.is_finite() && dx.hypot(dy) < hit_m - DEPTH_M
    }

    /// Of the known surfaces that the scanner would see from `pose`, the share that the scan has seen through, 0 to 1.
    pub(crate) fn contradicted(&self, surfaces: &SurfelGrid, pose: &Pose2) -> f32 {
        let laser = Pose2::new(self.t_base_laser.x_m, self.t_base_laser.y_m, 0.0);
        let [x, y, sin, cos] = surfaces.relative(&pose.compose(&laser));
        let mut seen = 0_u32;
        let mut through = 0_u32;
        for surface in surfaces.stretches().filter(Stretch::has_normal) {
            let dx = surface.x - x;
            let dy = surface.y - y;
            let range_m = dx.hypot(dy);
            let incidence = -(surface.nx * dx + surface.ny * dy);
            let is_in_range = (MIN_RANGE_M..MAX_RANGE_M).contains(&range_m);
            if !is_in_range || incidence < MIN_INCIDENCE * range_m {
                continue;
            }
            let direction = (cos * dy - sin * dx).atan2(cos * dx + sin * dy);
            let hit_m = self.ranges[sector(direction).rem_euclid(SECTORS as i32) as usize];
            if hit_m.is_infinite() || hit_m < range_m - DEPTH_M {
                continue;
            }
            seen += 1;
            through += u32::from(hit_m > range_m + DEPTH_M);
        }
        through as f32 / seen.max(1) as f32
    }
}

fn sector(angle_rad: f32) -> i32 {
    (angle_rad.to_degrees() * (SECTORS as f32 / 360.0)).floor() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall from y = -3 to 3 at `x`, seen from the origin.
    fn wall(x: f32) -> Vec<Stretch> {
        let steps = (-30..=30).map(|step| 0.1 * step as f32);
        steps.map(|y| Stretch { x, y, nx: -1.0, ny: 0.0, weight: 1.0 }).collect()
    }

    fn contradicted(scan: &[Stretch], map: &[Stretch], pose: &Pose2) -> f32 {
        let mut surfaces = SurfelGrid::new(0.1);
        surfaces.clear([0.0; 2]);
        surfaces.insert(map, &Pose2::IDENTITY);
        Sight::new(scan, &Pose2::new(0.1, 0.0, 0.0)).contradicted(&surfaces, pose)
    }

    #[test]
    fn a_wall_in_front_of_what_was_hit_contradicts_and_one_behind_it_does_not() {
        let seen = wall(2.0);
        assert!(contradicted(&seen, &wall(2.0), &Pose2::IDENTITY) < 0.01);
        assert!(contradicted(&seen, &wall(1.0), &Pose2::IDENTITY) > 0.9);
        assert!(contradicted(&seen, &wall(4.0), &Pose2::IDENTITY) < 0.01);
        assert!(contradicted(&seen, &wall(2.0), &Pose2::new(-2.0, 0.0, 0.0)) < 0.01);
    }

    #[test]
    fn a_point_well_before_what_was_hit_is_through_and_one_on_it_or_behind_it_or_elsewhere_is_not()
    {
        let sight = Sight::new(&wall(2.0), &Pose2::new(0.1, 0.0, 0.0));
        assert!(sight.is_through(1.0, 0.0) && sight.is_through(1.6, 0.5));
        for [x, y] in [[1.8, 0.0], [2.0, 1.0], [3.0, 0.0], [-1.0, 0.0]] {
            assert!(!sight.is_through(x, y), "{x} {y}");
        }
    }

    #[test]
    fn the_back_of_a_wall_is_not_seen() {
        let back: Vec<_> = wall(1.0).iter().map(|wall| Stretch { nx: 1.0, ..*wall }).collect();
        assert!(contradicted(&wall(2.0), &back, &Pose2::IDENTITY) < 0.01);
    }
}
