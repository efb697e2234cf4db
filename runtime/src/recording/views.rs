//! Poses, map, path and depth as Foxglove messages for viewers. Replay does not read them.

use fox::packed_element_field::NumericType;
use foxglove::messages as fox;
use hal::{CameraModel, DepthMap, Distortion, LaserScan, Pose2, Pose3};
use nalgebra::UnitQuaternion;

use super::scan;

const UPRIGHT: fox::Quaternion = fox::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };

/// The loop's map, path and depth after a tick, for viewers. The caller decides how often each is recorded.
#[derive(Debug, Clone, Default)]
pub struct Views {
    /// The map, if it is to be recorded after this tick.
    pub map: Option<MapView>,
    /// The planned path from the robot to the goal, in `map`, metres. An empty path removes the one on display.
    pub path_m: Option<Vec<[f64; 2]>>,
    /// The depth that went into the map.
    pub depth: Option<DepthMap>,
}

/// A map in the form of `nav_msgs/OccupancyGrid` of ROS.
#[derive(Debug, Clone, PartialEq)]
pub struct MapView {
    /// Corner of the first cell, in `map`, metres.
    pub origin_m: [f64; 2],
    /// Edge of a cell, metres.
    pub cell_m: f64,
    /// Cells along x.
    pub columns: usize,
    /// Row-major, rows along y: -1 unknown, 0 free to 100 occupied.
    pub occupancy: Vec<i8>,
}

/// A time as Foxglove writes it; `None` for one that it cannot hold.
pub fn timestamp(time_ns: u64) -> Option<fox::Timestamp> {
    let seconds = u32::try_from(time_ns / 1_000_000_000).ok()?;
    fox::Timestamp::new_checked(seconds, (time_ns % 1_000_000_000) as u32)
}

/// The intrinsics of the images.
pub fn calibration(model: &CameraModel, time_ns: u64) -> fox::CameraCalibration {
    let (distortion_model, d) = match model.distortion {
        Distortion::PlumbBob(coefficients) => ("plumb_bob", coefficients.to_vec()),
        Distortion::Fisheye(coefficients) => ("kannala_brandt", coefficients.to_vec()),
        _ => ("plumb_bob", vec![0.0; 5]),
    };
    let CameraModel { fx, fy, cx, cy, .. } = *model;
    fox::CameraCalibration {
        timestamp: timestamp(time_ns),
        frame_id: "camera_optical".to_owned(),
        width: model.width as u32,
        height: model.height as u32,
        distortion_model: distortion_model.to_owned(),
        d,
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

/// A pose in `frame`; `None` when it is not finite, because viewers drop the whole scene when it holds a NaN.
pub fn pose_in(frame: &str, pose: &Pose2, time_ns: u64) -> Option<fox::PoseInFrame> {
    if !pose.is_finite() {
        return None;
    }
    Some(fox::PoseInFrame {
        timestamp: timestamp(time_ns),
        frame_id: frame.to_owned(),
        pose: Some(self::pose(&pose.to_pose3())),
    })
}

/// Poses of `odom` in `map`, of the robot in `odom` and of its sensors in `base_link` (REP-105). The mounts never change, but
/// every tick repeats them, because a viewer that jumps in time reads only the last message of a channel.
pub fn transforms(
    t_map_odom: &Pose2,
    t_odom_base: &Pose2,
    t_base_camera: &Pose3,
    t_base_laser: &Pose3,
    time_ns: u64,
) -> fox::FrameTransforms {
    let mut transforms = vec![
        transform("base_link", "camera_optical", t_base_camera, time_ns),
        transform("base_link", "laser", t_base_laser, time_ns),
    ];
    if t_odom_base.is_finite() && t_map_odom.is_finite() {
        transforms.push(transform("odom", "base_link", &t_odom_base.to_pose3(), time_ns));
        transforms.push(transform("map", "odom", &t_map_odom.to_pose3(), time_ns));
    }
    fox::FrameTransforms { transforms }
}

/// A scan in the frame of the scanner. The live view gives it a real date in place of the scan's own time.
pub fn scan(scan: &LaserScan, time_ns: u64) -> fox::LaserScan {
    let geometry = &scan.geometry;
    fox::LaserScan {
        timestamp: timestamp(time_ns),
        frame_id: "laser".to_owned(),
        pose: Some(fox::Pose {
            position: Some(fox::Vector3::default()),
            orientation: Some(UPRIGHT),
        }),
        start_angle: geometry.angle_min_rad,
        end_angle: geometry.angle_rad(scan.ranges.len().saturating_sub(1)),
        ranges: scan.ranges.iter().map(|range| scan::encode(*range)).collect(),
        intensities: Vec::new(),
    }
}

fn transform(parent: &str, child: &str, pose: &Pose3, time_ns: u64) -> fox::FrameTransform {
    fox::FrameTransform {
        timestamp: timestamp(time_ns),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(fox_vector(pose)),
        rotation: Some(fox_quaternion(&pose.rotation)),
    }
}

/// Corner points in `map` as poses along the path.
pub fn path(points_m: &[[f64; 2]], time_ns: u64) -> fox::PosesInFrame {
    let poses = (0..points_m.len()).map(|at| {
        let [x_m, y_m] = points_m[at];
        pose(&Pose2 { x_m, y_m, yaw_rad: yaw_on_path(points_m, at) }.to_pose3())
    });
    fox::PosesInFrame {
        timestamp: timestamp(time_ns),
        frame_id: "map".to_owned(),
        poses: poses.collect(),
    }
}

/// Direction of the leg that begins at point `at`. The last pose has the yaw of the last leg.
fn yaw_on_path(points_m: &[[f64; 2]], at: usize) -> f64 {
    let from = if at + 1 < points_m.len() { at } else { at.saturating_sub(1) };
    match points_m.get(from..=from + 1) {
        Some([from, to]) => (to[1] - from[1]).atan2(to[0] - from[0]),
        _ => 0.0,
    }
}

/// Every cell holds a colour for viewers and the occupancy for programs.
///
/// # Errors
/// Cells that do not make whole rows.
pub fn grid(map: &MapView, time_ns: u64) -> Result<fox::Grid, String> {
    const CELL_BYTES: u32 = 5;
    let columns =
        u32::try_from(map.columns).map_err(|_| format!("{} columns are too many", map.columns))?;
    if columns == 0 || !map.occupancy.len().is_multiple_of(map.columns) {
        return Err(format!("{} cells do not make rows of {columns}", map.occupancy.len()));
    }
    let data: Vec<u8> = map.occupancy.iter().flat_map(|value| cell_bytes(*value)).collect();
    Ok(fox::Grid {
        timestamp: timestamp(time_ns),
        frame_id: "map".to_owned(),
        pose: Some(pose(
            &Pose2 { x_m: map.origin_m[0], y_m: map.origin_m[1], yaw_rad: 0.0 }.to_pose3(),
        )),
        column_count: columns,
        cell_size: Some(fox::Vector2 { x: map.cell_m, y: map.cell_m }),
        row_stride: columns * CELL_BYTES,
        cell_stride: CELL_BYTES,
        fields: vec![
            field("red", 0, NumericType::Uint8),
            field("green", 1, NumericType::Uint8),
            field("blue", 2, NumericType::Uint8),
            field("alpha", 3, NumericType::Uint8),
            field("occupancy", 4, NumericType::Int8),
        ],
        data: data.into(),
    })
}

/// A field of the cells of a grid or the points of a cloud.
#[must_use]
pub fn field(name: &str, offset: u32, r#type: NumericType) -> fox::PackedElementField {
    fox::PackedElementField { name: name.to_owned(), offset, r#type: r#type as i32 }
}

/// Red, green, blue, alpha, occupancy. Unknown is nearly transparent, free is white, occupied is black.
fn cell_bytes(occupancy: i8) -> [u8; 5] {
    let value = occupancy.to_le_bytes()[0];
    if occupancy < 0 {
        return [128, 128, 128, 40, value];
    }
    let grey = 255 - u16::from(value.min(100)) * 255 / 100;
    [grey as u8, grey as u8, grey as u8, 255, value]
}

/// Converts a pose to Foxglove's message.
#[must_use]
pub fn pose(pose: &Pose3) -> fox::Pose {
    fox::Pose {
        position: Some(fox_vector(pose)),
        orientation: Some(fox_quaternion(&pose.rotation)),
    }
}

fn fox_vector(pose: &Pose3) -> fox::Vector3 {
    let t = &pose.translation;
    fox::Vector3 { x: t.x, y: t.y, z: t.z }
}

fn fox_quaternion(rotation: &UnitQuaternion<f64>) -> fox::Quaternion {
    fox::Quaternion { x: rotation.i, y: rotation.j, z: rotation.k, w: rotation.w }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_is_white_occupied_is_black_and_unknown_is_see_through() {
        assert_eq!(cell_bytes(0), [255, 255, 255, 255, 0]);
        assert_eq!(cell_bytes(100), [0, 0, 0, 255, 100]);
        assert_eq!(cell_bytes(-1), [128, 128, 128, 40, 255]);
    }

    #[test]
    fn a_grid_with_a_torn_row_is_refused() {
        let map = MapView { origin_m: [0.0; 2], cell_m: 0.05, columns: 3, occupancy: vec![0; 7] };
        assert!(grid(&map, 0).unwrap_err().contains('7'));
        assert_eq!(grid(&MapView { occupancy: vec![0; 6], ..map }, 0).unwrap().data.len(), 30);
    }

    #[test]
    fn poses_on_a_path_point_along_it() {
        let message = path(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], 0);
        let yaws: Vec<f64> = message
            .poses
            .iter()
            .map(|p| p.orientation.unwrap())
            .map(|q| 2.0 * q.z.atan2(q.w))
            .collect();
        let quarter = std::f64::consts::FRAC_PI_2;
        assert!(
            (yaws[0] - 0.0).abs() < 1e-12
                && (yaws[1] - quarter).abs() < 1e-12
                && (yaws[2] - quarter).abs() < 1e-12
        );
        assert!(path(&[], 0).poses.is_empty());
    }

    #[test]
    fn a_pose_with_nan_is_not_shown() {
        let lost = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
        assert!(pose_in("odom", &lost, 0).is_none());
        let mount = Pose3::identity();
        assert_eq!(transforms(&Pose2::IDENTITY, &lost, &mount, &mount, 0).transforms.len(), 2);
        assert_eq!(
            transforms(&Pose2::IDENTITY, &Pose2::IDENTITY, &mount, &mount, 0).transforms.len(),
            4
        );
    }

    #[test]
    fn a_time_that_foxglove_cannot_hold_has_no_timestamp() {
        assert_eq!(timestamp(u64::MAX), None);
        assert_eq!(timestamp(1_500_000_000), Some(fox::Timestamp::new(1, 500_000_000)));
    }
}
