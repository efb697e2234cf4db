//! Encoding of recorded ticks as ROS messages. The recording already uses ROS frames and units (REP-103, REP-105).

use hal::{CameraModel, Distortion, LaserScan, Pose2, Pose3, Range, Twist2};
use runtime::recording::{RgbImage, Severity, lost_reason, sentence};
use runtime::tick::Decision;

use super::super::maps::Map;
use super::cdr::Cdr;

/// A time as builtin_interfaces/Time has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stamp {
    sec: i32,
    nanosec: u32,
}

impl Stamp {
    /// `None` when the seconds do not fit into 31 bits, which is after 68 years.
    pub(super) fn new(time_ns: u64) -> Option<Self> {
        let sec = i32::try_from(time_ns / 1_000_000_000).ok()?;
        Some(Self { sec, nanosec: (time_ns % 1_000_000_000) as u32 })
    }
}

/// geometry_msgs/TransformStamped: the pose of `child` in `parent`.
pub(super) struct Transform {
    pub stamp: Stamp,
    pub parent: &'static str,
    pub child: &'static str,
    pub pose: Pose3,
}

fn header(cdr: &mut Cdr, stamp: Stamp, frame: &str) {
    cdr.i32(stamp.sec);
    cdr.u32(stamp.nanosec);
    cdr.string(frame);
}

/// geometry_msgs/Pose and Transform have the same layout.
fn pose(cdr: &mut Cdr, pose: &Pose3) {
    let t = pose.translation.vector;
    let q = pose.rotation;
    cdr.array(&[t.x, t.y, t.z, q.i, q.j, q.k, q.w]);
}

/// A frame as sensor_msgs/Image.
pub(super) fn image(stamp: Stamp, frame: &RgbImage) -> Vec<u8> {
    let mut cdr = Cdr::new();
    header(&mut cdr, stamp, "camera_optical");
    cdr.u32(frame.height as u32);
    cdr.u32(frame.width as u32);
    cdr.string("rgb8");
    // Not big-endian.
    cdr.u8(0);
    cdr.u32(frame.width as u32 * 3);
    cdr.octets(&frame.rgb);
    cdr.into_bytes()
}

/// The calibration of a camera as sensor_msgs/CameraInfo.
pub(super) fn camera_info(stamp: Stamp, camera: &CameraModel) -> Vec<u8> {
    let (model, coefficients) = match &camera.distortion {
        Distortion::PlumbBob(k) => ("plumb_bob", &k[..]),
        // The name that ROS uses for the model of Kannala and Brandt.
        Distortion::Fisheye(k) => ("equidistant", &k[..]),
        _ => ("plumb_bob", &[0.0; 5][..]),
    };
    let CameraModel { fx, fy, cx, cy, .. } = *camera;
    let mut cdr = Cdr::new();
    header(&mut cdr, stamp, "camera_optical");
    cdr.u32(camera.height as u32);
    cdr.u32(camera.width as u32);
    cdr.string(model);
    cdr.length(coefficients.len());
    cdr.array(coefficients);
    cdr.array(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    cdr.array(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    cdr.array(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, and the region of interest is the whole image.
    (0..6).for_each(|_| cdr.u32(0));
    cdr.bool(false);
    cdr.into_bytes()
}

/// sensor_msgs/LaserScan. Beams without a distance follow REP-117: no return is +infinity, too near is -infinity, and not
/// measured is NaN.
pub(super) fn laser_scan(stamp: Stamp, scan: &LaserScan) -> Vec<u8> {
    let geometry = &scan.geometry;
    let period_s = geometry.period_ns as f64 * 1e-9;
    let last = geometry.angle_rad(scan.ranges.len().saturating_sub(1));
    let mut cdr = Cdr::new();
    header(&mut cdr, stamp, "laser");
    cdr.f32(geometry.angle_min_rad as f32);
    cdr.f32(last as f32);
    cdr.f32(geometry.angle_increment_rad as f32);
    cdr.f32((period_s * geometry.angle_increment_rad / std::f64::consts::TAU) as f32);
    cdr.f32(period_s as f32);
    cdr.f32(geometry.range_min_m);
    cdr.f32(geometry.range_max_m);
    cdr.length(scan.ranges.len());
    for range in &scan.ranges {
        cdr.f32(match range {
            Range::Hit(distance_m) => *distance_m,
            Range::NoReturn => f32::INFINITY,
            Range::TooNear => f32::NEG_INFINITY,
            Range::Error => f32::NAN,
        });
    }
    // No intensities.
    cdr.length(0);
    cdr.into_bytes()
}

/// nav_msgs/Odometry. The covariances are zero, which means unknown in ROS: they are not recorded.
pub(super) fn odometry(stamp: Stamp, t_odom_base: &Pose2, twist: &Twist2) -> Vec<u8> {
    let mut cdr = Cdr::new();
    header(&mut cdr, stamp, "odom");
    cdr.string("base_link");
    pose(&mut cdr, &t_odom_base.to_pose3());
    cdr.array(&[0.0; 36]);
    cdr.array(&[twist.linear_mps, 0.0, 0.0, 0.0, 0.0, twist.angular_radps]);
    cdr.array(&[0.0; 36]);
    cdr.into_bytes()
}

/// Poses between frames as tf2_msgs/TFMessage.
pub(super) fn transforms(transforms: &[Transform]) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.length(transforms.len());
    for transform in transforms {
        header(&mut cdr, transform.stamp, transform.parent);
        cdr.string(transform.child);
        pose(&mut cdr, &transform.pose);
    }
    cdr.into_bytes()
}

/// A map as nav_msgs/OccupancyGrid.
pub(super) fn occupancy_grid(stamp: Stamp, map: &Map) -> Vec<u8> {
    let mut cdr = Cdr::new();
    header(&mut cdr, stamp, "map");
    cdr.i32(stamp.sec);
    cdr.u32(stamp.nanosec);
    cdr.f32(map.cell_m as f32);
    cdr.u32(map.columns);
    cdr.u32(map.rows);
    let [x_m, y_m] = map.origin_m;
    pose(&mut cdr, &Pose2 { x_m, y_m, yaw_rad: 0.0 }.to_pose3());
    cdr.length(map.occupancy.len());
    map.occupancy.iter().for_each(|value| cdr.u8(value.to_le_bytes()[0]));
    cdr.into_bytes()
}

/// diagnostic_msgs/DiagnosticArray with one status: what the robot decided, and why.
pub(super) fn diagnostics(stamp: Stamp, decision: &Decision) -> Vec<u8> {
    let mut level = 0;
    let mut message = Vec::new();
    for (severity, text) in decision.events.iter().map(sentence) {
        level = level.max(match severity {
            Severity::Info => 0,
            Severity::Warning => 1,
            Severity::Error => 2,
        });
        message.push(text);
    }
    let mut cdr = Cdr::new();
    header(&mut cdr, stamp, "");
    cdr.length(1);
    cdr.u8(level);
    cdr.string("embodied_depth: decision");
    cdr.string(&message.join("; "));
    cdr.string("");
    let values = values(decision);
    cdr.length(values.len());
    for (key, value) in values {
        cdr.string(key);
        cdr.string(&value);
    }
    cdr.into_bytes()
}

/// The numbers of a decision. What a decision does not have is absent.
fn values(decision: &Decision) -> Vec<(&'static str, String)> {
    let mut values = vec![
        ("tick", decision.tick.to_string()),
        ("desired_mps", decision.desired.linear_mps.to_string()),
        ("desired_radps", decision.desired.angular_radps.to_string()),
    ];
    if let Some(sent) = &decision.sent {
        values.push(("sent_mps", sent.linear_mps.to_string()));
        values.push(("sent_radps", sent.angular_radps.to_string()));
    }
    if let Some([x_m, y_m]) = decision.goal_m {
        values.push(("goal_x_m", x_m.to_string()));
        values.push(("goal_y_m", y_m.to_string()));
    }
    values.extend(decision.lost.map(|why| ("lost", lost_reason(why).to_owned())));
    values
}
