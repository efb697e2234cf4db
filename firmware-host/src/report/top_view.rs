//! What a camera without a known floor saw, from above: for sequences taken by hand.

use std::path::Path;

use hal::{CameraModel, Pose2, Pose3};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use runtime::mapping::{Cell, CellState, MapConfig, MapError, OccupancyGrid};
use runtime::perception::DepthEstimate;

use super::atomic::ReportError;
use super::map_picture::{Cells, MapPicture};

/// The map shows what stands between these distances below and above the camera's median height, metres: from the hip to
/// above the eyes of somebody who holds it.
const BELOW_M: f64 = 0.9;
const ABOVE_M: f64 = 0.4;

/// The weight of "on average the camera was held upright" beside "its horizon was level in every picture".
const UPRIGHT: f64 = 0.02;

/// A map in a frame of its own: z is up and `BELOW_M` at the camera's median height, y is where the first picture looks.
#[derive(Debug)]
pub struct TopView {
    t_level_world: Pose3,
    grid: OccupancyGrid,
    trajectory: Vec<Pose2>,
}

impl TopView {
    /// An empty map for a camera that will be at `poses`; `up` is the world's, if known.
    ///
    /// # Errors
    /// When there are no poses, or such as have no direction.
    pub fn new(poses: &[Pose3], up: Option<Vector3<f64>>) -> Result<Self, MapError> {
        let config = MapConfig {
            cell_m: 0.05,
            decay: 1.0,
            band_min_m: 0.0,
            band_max_m: (BELOW_M + ABOVE_M) as f32,
            mark_range_m: 4.0,
            clear_range_m: 4.0,
            ..MapConfig::default()
        };
        let t_level_world = levelled(poses, up.unwrap_or_else(|| upward(poses)));
        Ok(Self { t_level_world, grid: OccupancyGrid::new(&config)?, trajectory: Vec::new() })
    }

    /// Takes in where the camera is and what it sees there, if anything.
    ///
    /// # Errors
    /// A pose or a depth that cannot be used.
    pub fn add(
        &mut self,
        t_world_camera: &Pose3,
        depth: Option<&DepthEstimate>,
        camera: &CameraModel,
    ) -> Result<(), MapError> {
        let t_level_camera = self.t_level_world * t_world_camera;
        let (at, ahead) = (t_level_camera.translation, t_level_camera * Vector3::z());
        let pose = Pose2::new(at.x, at.y, ahead.y.atan2(ahead.x));
        self.trajectory.push(pose);
        let Some(depth) = depth else { return Ok(()) };
        self.grid.begin_update(&pose)?;
        let seen = self.grid.integrate_depth(depth, camera, &t_level_camera).map(|_| ());
        self.grid.finish_update();
        // Who looks straight up or down sees no walls.
        if seen == Err(MapError::CameraVertical) { Ok(()) } else { seen }
    }

    /// Draws and writes `map.png` into `dir`.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn write(&self, title: &str, dir: &Path) -> Result<(), ReportError> {
        let (width, cells, origin_m) = self.cells();
        let map = Cells { width, cells: &cells, resolution_m: self.grid.cell_m(), origin_m };
        let trajectory = &self.trajectory;
        MapPicture { title, map, trajectory, goals: &[], trips: &[], reachable: None }.write(dir)
    }

    /// Everything known: columns, cells row by row, and the outer corner of the first.
    fn cells(&self) -> (usize, Vec<CellState>, [f64; 2]) {
        let Some(known) = self.grid.known_box() else {
            return (1, vec![CellState::Unknown], [0.0; 2]);
        };
        let rows = known.min.y..=known.max.y;
        let cells = rows.flat_map(|y| {
            (known.min.x..=known.max.x).map(move |x| self.grid.state(Cell::new(x, y)))
        });
        let corner = [known.min.x, known.min.y].map(|cells| f64::from(cells) * self.grid.cell_m());
        (known.width(), cells.collect(), corner)
    }
}

/// Up, from how a camera was held. Whatever it looked at, its horizon was about level: up is square to the x axes of all
/// pictures. Where they all point the same way that leaves a circle of directions; the mean of the cameras' own up decides.
fn upward(poses: &[Pose3]) -> Vector3<f64> {
    let count = poses.len().max(1) as f64;
    let mean: Vector3<f64> = poses.iter().map(|pose| pose * -Vector3::y() / count).sum();
    let mean = mean.try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let horizons: Matrix3<f64> =
        poses.iter().map(|pose| pose * Vector3::x()).map(|x| x * x.transpose() / count).sum();
    let tilt = horizons + UPRIGHT * (Matrix3::identity() - mean * mean.transpose());
    let eigen = tilt.symmetric_eigen();
    let up = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    if up.dot(&mean) < 0.0 { -up } else { up }
}

/// The frame of the map in the world, inverted.
fn levelled(poses: &[Pose3], up: Vector3<f64>) -> Pose3 {
    let up = up.try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let level = |axis: Vector3<f64>| (axis - up * axis.dot(&up)).try_normalize(1e-3);
    // A first picture of the floor has its upper edge ahead.
    let ahead = poses
        .first()
        .and_then(|first| level(first * Vector3::z()).or_else(|| level(first * -Vector3::y())));
    let ahead = ahead
        .or_else(|| level(Vector3::x()))
        .or_else(|| level(Vector3::y()))
        .unwrap_or_else(Vector3::y);
    let rotation = Rotation3::from_basis_unchecked(&[ahead.cross(&up), ahead, up]).inverse();
    let mut heights: Vec<f64> = poses.iter().map(|pose| up.dot(&pose.translation.vector)).collect();
    heights.sort_by(f64::total_cmp);
    let median_m = heights.get(heights.len() / 2).copied().unwrap_or(0.0);
    Pose3::from_parts(
        Translation3::new(0.0, 0.0, BELOW_M - median_m),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half the sides of a room without furniture, metres.
    const HALF: [f64; 2] = [2.5, 1.8];

    fn camera() -> CameraModel {
        CameraModel::pinhole(160, 96, 1.4)
    }

    /// A camera carried round the room, nodding and rolling, 1.4 m above the floor; y is up in the room's frame here.
    fn carried(frames: usize, turn_rad: f64, nod_rad: f64) -> Vec<Pose3> {
        (0..frames)
            .map(|frame| {
                let part = frame as f64 / frames as f64;
                let yaw = turn_rad * part;
                let pitch = nod_rad + 0.1 * (part * 40.0).sin();
                let mount = hal::camera_mount(0.0, 1.4 + 0.05 * (part * 23.0).sin(), pitch);
                let roll =
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.08 * (part * 31.0).sin());
                Pose2::new(0.7 * yaw.cos(), 0.5 * yaw.sin(), yaw).to_pose3() * mount * roll
            })
            .collect()
    }

    /// What that camera sees of the walls, floor and ceiling of a box.
    fn look(t_room_camera: &Pose3) -> DepthEstimate {
        let camera = camera();
        let mut estimate = DepthEstimate::none(camera.width, camera.height);
        let at = t_room_camera.translation.vector;
        for v in 0..camera.height {
            for u in 0..camera.width {
                let ray = t_room_camera * camera.ray(u as f64, v as f64);
                let to = |axis: usize, low: f64, high: f64| {
                    (if ray[axis] > 0.0 { high } else { low } - at[axis]) / ray[axis]
                };
                let depth_m =
                    to(0, -HALF[0], HALF[0]).min(to(1, -HALF[1], HALF[1])).min(to(2, 0.0, 2.6));
                estimate.depth.values_mut()[v * camera.width + u] = depth_m as f32;
            }
        }
        estimate.confidence.fill(1.0);
        estimate
    }

    /// Any frame that a recording may use for its world.
    fn t_world_room() -> Pose3 {
        let turn = Vector3::new(2.0, -0.7, 0.4);
        Pose3::from_parts(
            Translation3::new(7.0, -3.0, 11.0),
            UnitQuaternion::from_scaled_axis(turn),
        )
    }

    #[test]
    fn the_walls_of_a_room_seen_by_a_camera_in_the_hand_are_where_they_are() {
        let in_room = carried(120, std::f64::consts::TAU, 0.15);
        let poses: Vec<Pose3> = in_room.iter().map(|pose| t_world_room() * pose).collect();
        let mut view = TopView::new(&poses, None).unwrap();
        for (pose, in_room) in poses.iter().zip(&in_room) {
            view.add(pose, Some(&look(in_room)), &camera()).unwrap();
        }
        let t_room_level = (view.t_level_world * t_world_room()).inverse();
        let (width, cells, corner) = view.cells();
        let (mut walls, mut inside) = (0, 0);
        for (index, state) in cells.iter().enumerate() {
            let [x, y] = [index % width, index / width];
            let [x, y] = [corner[0] + (x as f64 + 0.5) * 0.05, corner[1] + (y as f64 + 0.5) * 0.05];
            let at = t_room_level * nalgebra::Point3::new(x, y, BELOW_M);
            let beyond_m = (at.x.abs() - HALF[0]).max(at.y.abs() - HALF[1]);
            match state {
                CellState::Occupied => {
                    assert!(beyond_m.abs() < 0.1, "a wall at {:.2} {:.2}", at.x, at.y);
                    walls += 1;
                }
                CellState::Free => {
                    assert!(beyond_m < 0.1, "free at {:.2} {:.2}", at.x, at.y);
                    inside += 1;
                }
                CellState::Unknown => {}
            }
        }
        // The walls are 17.2 m long, the floor 18 m2.
        assert!(walls >= 17 * 20 && inside > 15 * 400, "{walls} cells of wall, {inside} within");
    }

    #[test]
    fn up_is_found_however_the_camera_is_held() {
        // Turning round it does not matter where the camera looks; looking one way it has to be held upright.
        for (turn_rad, nod_rad, most_rad) in [(6.0, 0.5, 0.03), (1.0, 0.3, 0.1), (0.0, 0.0, 0.03)] {
            let poses: Vec<Pose3> =
                carried(200, turn_rad, nod_rad).iter().map(|pose| t_world_room() * pose).collect();
            let error_rad = upward(&poses).angle(&(t_world_room() * Vector3::z()));
            assert!(
                error_rad < most_rad,
                "turned {turn_rad}, nodding {nod_rad}: off by {error_rad}"
            );
        }
    }

    #[test]
    fn what_the_dataset_says_of_up_counts() {
        let poses = carried(10, 0.0, 0.6);
        let view = TopView::new(&poses, Some(2.0 * Vector3::z())).unwrap();
        assert!((view.t_level_world * Vector3::z() - Vector3::z()).norm() < 1e-9);
        let heights = poses.iter().map(|pose| (view.t_level_world * pose).translation.z);
        assert!(heights.into_iter().all(|height_m| (height_m - BELOW_M).abs() < 0.11));
    }

    #[test]
    fn looking_straight_down_or_seeing_nothing_only_lengthens_the_way() {
        let down = Pose3::from_parts(
            Translation3::new(0.0, 0.0, 1.0),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        );
        let mut view = TopView::new(&[down], Some(Vector3::z())).unwrap();
        view.add(&down, Some(&look(&down)), &camera()).unwrap();
        view.add(&down, None, &camera()).unwrap();
        assert_eq!((view.trajectory.len(), view.cells().1), (2, vec![CellState::Unknown]));
    }
}
