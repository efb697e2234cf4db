//! What a map may believe of dense depth.
//!
//! Dense depth holds assumptions: floor before what the scanner hit, an upright wall above it, and filled holes. Most of them are right,
//! and they correct coarse depth on blank walls. But a robot must not drive into what an assumption hides:
//!
//! * Where coarse depth has no value, a table top or stairs down may be what was not seen. There the confidence stays below what the map
//!   takes (`DepthEstimate::doubt_unseen`).
//! * Where coarse depth is nearer, it may be a table top before the wall that the scanner sees between its legs. Where coarse depth is
//!   farther than a floor, it may be stairs down. Coarse depth is kept in both cases, because a touch or a fall costs more than a detour.
//!   Only if the odds p / (1 - p) of the other depth are `OTHER_ODDS` times as good, coarse depth is a mistake of a blank wall or of a
//!   patterned floor: then the map takes neither of them.
//!
//! Where coarse depth is farther than a wall, the more probable of both counts, as `dense.rs` has chosen.
//!
//! A network that is given dense depth is limited only where coarse depth has no value. With all of these limits it touched two times instead
//! of three in the three drives in which it touches, and had 7 % of the cells off by 10 cm instead of 1 % (docs/accuracy.md).

use hal::{CameraModel, Pose3};

use super::DepthEstimate;
use super::estimate::UNCONFIRMED;

/// From this ratio on, a depth lies behind the other one. Within 25 % two depths count as equal elsewhere, but a table top that is moved by
/// 25 % of a metre is touched.
const FARTHER: f32 = 1.05;
/// Depth within this ratio of the floor's is the floor's.
const ON_FLOOR: f32 = 1.1;
/// How much better the odds of the other depth must be.
const OTHER_ODDS: f32 = 4.0;

/// What a map may believe of frames of one camera.
pub struct MapDepth {
    /// Depth at which each pixel sees the floor that the robot stands on; infinite at the horizon and above.
    floor_m: Vec<f32>,
    estimate: DepthEstimate,
}

impl MapDepth {
    /// For frames of `camera`, which is mounted at `t_base_camera`.
    #[must_use]
    pub fn new(camera: &CameraModel, t_base_camera: &Pose3) -> Self {
        let height_m = t_base_camera.translation.z;
        let rays = (0..camera.height)
            .flat_map(|row| (0..camera.width).map(move |column| (column, row)))
            .map(|(column, row)| camera.ray(column as f64, row as f64));
        let down = rays.map(|ray| -(t_base_camera.rotation * ray).z);
        let floor_m = down.map(|down| if down > 0.0 { height_m / down } else { f64::INFINITY });
        Self {
            floor_m: floor_m.map(|depth_m| depth_m as f32).collect(),
            estimate: DepthEstimate::none(camera.width, camera.height),
        }
    }

    /// Limits the dense depth of a frame by `coarse`, which is `None` if the frame has no coarse depth.
    pub fn limit(&mut self, dense: &DepthEstimate, coarse: Option<&DepthEstimate>) {
        let Self { floor_m, estimate } = self;
        estimate.copy_from(dense);
        estimate.doubt_unseen(coarse);
        let Some(coarse) = coarse else { return };
        let seen = coarse.depth.values().iter().zip(&coarse.confidence).zip(floor_m);
        let own = estimate.depth.values_mut().iter_mut().zip(&mut estimate.confidence);
        for ((depth_m, confidence), ((seen_m, seen), floor_m)) in own.zip(seen) {
            let hides =
                hides_obstacle(*depth_m, *seen_m) || hides_drop(*depth_m, *seen_m, *floor_m);
            if *seen_m <= 0.0 || !hides {
                continue;
            }
            if odds(*confidence) < OTHER_ODDS * odds(*seen) {
                *depth_m = *seen_m;
                *confidence = *seen;
            } else {
                *confidence = confidence.min(UNCONFIRMED);
            }
        }
    }

    /// The result of the last [`limit`](Self::limit).
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }
}

fn hides_obstacle(depth_m: f32, seen_m: f32) -> bool {
    depth_m > FARTHER * seen_m
}

fn hides_drop(depth_m: f32, seen_m: f32, floor_m: f32) -> bool {
    depth_m < ON_FLOOR * floor_m && ON_FLOOR * depth_m > floor_m && seen_m > FARTHER * floor_m
}

fn odds(confidence: f32) -> f32 {
    let confidence = confidence.clamp(0.01, 0.99);
    confidence / (1.0 - confidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::DepthMap;

    /// An estimate of one pixel.
    fn pixel(depth_m: f32, confidence: f32) -> DepthEstimate {
        DepthEstimate {
            depth: DepthMap::from_vec(1, 1, vec![depth_m]).unwrap(),
            confidence: vec![confidence],
        }
    }

    fn believed(dense: (f32, f32), coarse: Option<(f32, f32)>) -> (f32, f32) {
        believed_before_floor(dense, coarse, f32::INFINITY)
    }

    fn believed_before_floor(
        dense: (f32, f32),
        coarse: Option<(f32, f32)>,
        floor_m: f32,
    ) -> (f32, f32) {
        let mut map = MapDepth { floor_m: vec![floor_m], estimate: pixel(0.0, 0.0) };
        let coarse = coarse.map(|(depth_m, confidence)| pixel(depth_m, confidence));
        map.limit(&pixel(dense.0, dense.1), coarse.as_ref());
        (map.last().depth.values()[0], map.last().confidence[0])
    }

    #[test]
    fn what_no_motion_has_confirmed_stays_below_what_the_map_takes() {
        assert_eq!(believed((3.0, 0.95), None), (3.0, 0.75));
        assert_eq!(believed((3.0, 0.95), Some((0.0, 0.0))), (3.0, 0.75));
        assert_eq!(believed((3.0, 0.6), None), (3.0, 0.6));
    }

    #[test]
    fn a_wall_that_is_about_as_probable_as_the_table_before_it_does_not_hide_the_table() {
        assert_eq!(believed((3.0, 0.92), Some((1.5, 0.85))), (1.5, 0.85));
        // Odds of 9 for the table, of 32 for the wall.
        assert_eq!(believed((3.0, 0.97), Some((1.5, 0.9))), (1.5, 0.9));
    }

    #[test]
    fn where_a_wall_is_far_more_probable_the_map_takes_neither_it_nor_the_depth_before_it() {
        // Odds of 1.5 and of 19.
        assert_eq!(believed((3.0, 0.95), Some((1.5, 0.6))), (3.0, 0.75));
    }

    #[test]
    fn a_nearer_wall_replaces_coarse_depth_and_so_does_one_at_the_same_place() {
        assert_eq!(believed((1.5, 0.85), Some((3.0, 0.84))), (1.5, 0.85));
        assert_eq!(believed((1.55, 0.85), Some((1.5, 0.84))), (1.55, 0.85));
    }

    #[test]
    fn a_floor_that_is_about_as_probable_as_the_stairs_below_it_does_not_hide_them() {
        assert_eq!(believed_before_floor((1.5, 0.92), Some((1.8, 0.85)), 1.5), (1.8, 0.85));
    }

    #[test]
    fn where_the_floor_is_far_more_probable_the_map_takes_neither_it_nor_the_depth_below() {
        assert_eq!(believed_before_floor((1.5, 0.95), Some((1.8, 0.6)), 1.5), (1.5, 0.75));
    }

    #[test]
    fn an_obstacle_before_the_floor_is_kept_where_coarse_depth_sees_through_the_floor() {
        assert_eq!(believed_before_floor((1.0, 0.85), Some((1.8, 0.84)), 1.5), (1.0, 0.85));
    }

    #[test]
    fn the_floor_is_where_the_rays_of_the_mount_meet_it_and_nowhere_above_the_horizon() {
        let camera = CameraModel::pinhole(64, 48, 1.5);
        let mount = hal::CameraMount { roll_deg: 2.0, ..Default::default() };
        let map = MapDepth::new(&camera, &mount.t_base_camera());
        for (index, depth_m) in map.floor_m.iter().enumerate() {
            let [column, row] = [index % 64, index / 64].map(|at| at as f64);
            let ray = mount.t_base_camera().rotation * camera.ray(column, row);
            match depth_m.is_finite() {
                true => assert!((0.8 + f64::from(*depth_m) * ray.z).abs() < 1e-5),
                false => assert!(ray.z >= 0.0),
            }
        }
        assert!(map.floor_m.iter().any(|depth_m| depth_m.is_finite()));
    }
}
