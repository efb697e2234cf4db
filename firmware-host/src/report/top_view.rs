//! A map from a camera whose height and tilt are unknown, for sequences recorded with a hand-held
//! camera.

use std::path::Path;

use hal::{CameraModel, Pose2, Pose3};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use runtime::mapping::{Cell, CellState, MapConfig, MapError, OccupancyGrid, Surfaces};
use runtime::perception::DepthEstimate;

use super::atomic::ReportError;
use super::map_image::{Cells, MapPlot};

/// The map shows obstacles between these distances below and above the median height of the camera,
/// metres: from the hip to above the eyes of a person who holds the camera.
const BELOW_M: f64 = 0.9;
const ABOVE_M: f64 = 0.4;

/// Weight of the assumption that the camera was upright on average, relative to the assumption that
/// its horizon was level in every frame.
const UPRIGHT: f64 = 0.02;

/// A map in its own frame: z points up and is `BELOW_M` at the median height of the camera, and y
/// is the viewing direction of the first frame.
#[derive(Debug)]
pub struct TopView {
    t_level_world: Pose3,
    grid: OccupancyGrid,
    trajectory: Vec<Pose2>,
}

impl TopView {
    /// An empty map for a camera that will be at `poses`. `up` is the up direction of the world, if
    /// it is known.
    ///
    /// # Errors
    /// If the map cannot be created.
    pub fn new(poses: &[Pose3], up: Option<Vector3<f64>>) -> Result<Self, MapError> {
        let config = MapConfig {
            cell_m: 0.05,
            decay: 1.0,
            band_min_m: 0.0,
            band_max_m: (BELOW_M + ABOVE_M) as f32,
            mark_range_m: 4.0,
            clear_range_m: 4.0,
            // How high a camera is held above the floor is not known.
            drop_range_m: 0.0,
            ..MapConfig::default()
        };
        let t_level_world = levelled(poses, up.unwrap_or_else(|| upward(poses)));
        Ok(Self { t_level_world, grid: OccupancyGrid::new(&config)?, trajectory: Vec::new() })
    }

    /// Adds the pose of the camera in one frame and its depth, if there is any.
    ///
    /// # Errors
    /// If the pose or the depth is invalid.
    pub fn add(
        &mut self,
        t_world_camera: &Pose3,
        depth: Option<&DepthEstimate>,
        camera: &CameraModel,
    ) -> Result<(), MapError> {
        let t_level_camera = self.t_level_world * t_world_camera;
        let at = t_level_camera.translation;
        let ahead = t_level_camera * Vector3::z();
        let pose = Pose2::new(at.x, at.y, ahead.y.atan2(ahead.x));
        self.trajectory.push(pose);
        let Some(depth) = depth else { return Ok(()) };
        self.grid.begin_update(&pose)?;
        let seen = self
            .grid
            .integrate_depth(depth, camera, &t_level_camera, &Surfaces::default())
            .map(|_| ());
        self.grid.finish_update();
        // A camera that points straight up or down sees no walls.
        if seen == Err(MapError::CameraVertical) { Ok(()) } else { seen }
    }

    /// Draws the map and writes `map.png` into `dir`.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn write(&self, title: &str, dir: &Path) -> Result<(), ReportError> {
        let (width, cells, origin_m) = self.cells();
        let map = Cells { width, cells: &cells, resolution_m: self.grid.cell_m(), origin_m };
        let trajectory = &self.trajectory;
        let plot =
            MapPlot { title, figures: "", map, trajectory, goals: &[], trips: &[], truth: None };
        plot.write(dir)
    }

    /// The known part of the map: number of columns, cells row by row, outer corner of the first
    /// cell.
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

/// Estimates the up direction of the world from the poses of a hand-held camera. Its horizon is
/// about level, so up is orthogonal to the x axes of all frames. If all x axes are parallel, this
/// leaves a circle of directions, and the mean up direction of the camera decides.
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

/// The transform from the world into the frame of the map, `t_level_world`.
fn levelled(poses: &[Pose3], up: Vector3<f64>) -> Pose3 {
    let up = up.try_normalize(1e-9).unwrap_or_else(Vector3::z);
    // If the first frame points straight down, its upper edge points ahead.
    let ahead = poses.first().and_then(|first| {
        horizontal(first * Vector3::z(), up).or_else(|| horizontal(first * -Vector3::y(), up))
    });
    let ahead = ahead
        .or_else(|| horizontal(Vector3::x(), up))
        .or_else(|| horizontal(Vector3::y(), up))
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

/// The direction of the component of `axis` that is orthogonal to `up`; `None` if there is hardly
/// any.
fn horizontal(axis: Vector3<f64>, up: Vector3<f64>) -> Option<Vector3<f64>> {
    (axis - up * axis.dot(&up)).try_normalize(1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of the side lengths of a room without furniture, metres.
    const HALF: [f64; 2] = [2.5, 1.8];

    fn camera() -> CameraModel {
        CameraModel::pinhole(160, 96, 1.4)
    }

    /// Poses of a camera carried round the room, 1.4 m above the floor, with changing pitch and
    /// roll.
    fn carried(frames: usize, rotation_rad: f64, pitch_rad: f64) -> Vec<Pose3> {
        (0..frames)
            .map(|frame| {
                let part = frame as f64 / frames as f64;
                let yaw = rotation_rad * part;
                let pitch = pitch_rad + 0.1 * (part * 40.0).sin();
                let mount = hal::camera_mount(0.0, 1.4 + 0.05 * (part * 23.0).sin(), pitch);
                let roll =
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.08 * (part * 31.0).sin());
                Pose2::new(0.7 * yaw.cos(), 0.5 * yaw.sin(), yaw).to_pose3() * mount * roll
            })
            .collect()
    }

    /// Depth of the walls, floor and ceiling of the room.
    fn depth_from(t_room_camera: &Pose3) -> DepthEstimate {
        let camera = camera();
        let mut estimate = DepthEstimate::none(camera.width, camera.height);
        let at = t_room_camera.translation.vector;
        for v in 0..camera.height {
            for u in 0..camera.width {
                let ray = t_room_camera * camera.ray(u as f64, v as f64);
                let depth_m = [(-HALF[0], HALF[0]), (-HALF[1], HALF[1]), (0.0, 2.6)]
                    .iter()
                    .enumerate()
                    .map(|(axis, (low, high))| {
                        (if ray[axis] > 0.0 { high } else { low } - at[axis]) / ray[axis]
                    })
                    .fold(f64::INFINITY, f64::min);
                estimate.depth.values_mut()[v * camera.width + u] = depth_m as f32;
            }
        }
        estimate.confidence.fill(1.0);
        estimate
    }

    /// An arbitrary world frame of a recording.
    fn t_world_room() -> Pose3 {
        let rotation = Vector3::new(2.0, -0.7, 0.4);
        Pose3::from_parts(
            Translation3::new(7.0, -3.0, 11.0),
            UnitQuaternion::from_scaled_axis(rotation),
        )
    }

    #[test]
    fn a_hand_held_camera_maps_the_walls_of_a_room_at_their_true_positions() {
        let in_room = carried(120, std::f64::consts::TAU, 0.15);
        let poses: Vec<Pose3> = in_room.iter().map(|pose| t_world_room() * pose).collect();
        let mut view = TopView::new(&poses, None).unwrap();
        for (pose, in_room) in poses.iter().zip(&in_room) {
            view.add(pose, Some(&depth_from(in_room)), &camera()).unwrap();
        }
        let t_room_level = (view.t_level_world * t_world_room()).inverse();
        let (width, cells, corner) = view.cells();
        let mut walls = 0;
        let mut inside = 0;
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
        // The walls are 17.2 m long, and the floor has 18 m2.
        assert!(walls >= 17 * 20 && inside > 15 * 400, "{walls} cells of wall, {inside} within");
    }

    #[test]
    fn up_is_found_however_the_camera_is_held() {
        // If the camera rotates, its pitch does not matter. If it always points in one direction,
        // it has to be held upright.
        for (rotation_rad, pitch_rad, tolerance_rad) in
            [(6.0, 0.5, 0.03), (1.0, 0.3, 0.1), (0.0, 0.0, 0.03)]
        {
            let poses: Vec<Pose3> = carried(200, rotation_rad, pitch_rad)
                .iter()
                .map(|pose| t_world_room() * pose)
                .collect();
            let error_rad = upward(&poses).angle(&(t_world_room() * Vector3::z()));
            assert!(
                error_rad < tolerance_rad,
                "rotation {rotation_rad}, pitch {pitch_rad}: error {error_rad}"
            );
        }
    }

    #[test]
    fn the_up_direction_of_the_dataset_is_used() {
        let poses = carried(10, 0.0, 0.6);
        let view = TopView::new(&poses, Some(2.0 * Vector3::z())).unwrap();
        assert!((view.t_level_world * Vector3::z() - Vector3::z()).norm() < 1e-9);
        let heights = poses.iter().map(|pose| (view.t_level_world * pose).translation.z);
        assert!(heights.into_iter().all(|height_m| (height_m - BELOW_M).abs() < 0.11));
    }

    #[test]
    fn a_frame_straight_down_or_without_depth_only_extends_the_path() {
        let down = Pose3::from_parts(
            Translation3::new(0.0, 0.0, 1.0),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        );
        let mut view = TopView::new(&[down], Some(Vector3::z())).unwrap();
        view.add(&down, Some(&depth_from(&down)), &camera()).unwrap();
        view.add(&down, None, &camera()).unwrap();
        assert_eq!((view.trajectory.len(), view.cells().1), (2, vec![CellState::Unknown]));
    }
}
