use std::sync::LazyLock;

use firmware_host::config::Config;
use firmware_host::setup::Mission;
use hal::{ImageView, LaserScan, Pose2, Range, ScanGeometry, WheelFeedback};
use runtime::exploration::PolicyKind;
use runtime::imu::ImuInput;
use runtime::outside_pose::{OutsideInput, OutsidePose};
use runtime::recording::RecordedTick;
use runtime::robot::{DepthSource, Robot, RobotConfig};
use runtime::session::recompute;
use runtime::tick::{SafetyReport, TickInput};

/// The smallest allowed robot, to keep its state small.
const CONFIG: &str = "
camera = { width = 64, height = 32 }
map = { cell_m = 0.5, side_cells = 16, recenter_cells = 1 }
coarse = { keyframes = 1, parallax_px = [1.0] }
";
const TICKS: u64 = 3;

pub(crate) static ROBOT: LazyLock<RobotConfig> = LazyLock::new(|| {
    let config = Config::parse(CONFIG, "robot.toml".as_ref()).expect("a configuration");
    config.robot(&Mission {
        policy: PolicyKind::Active,
        depth_source: DepthSource::Coarse,
        seed: 1,
    })
});

/// Arbitrary bytes as a snapshot of a robot's state. They are refused, or the robot continues.
pub fn snapshot(bytes: &[u8]) {
    let mut robot = Robot::new(ROBOT.clone(), None).expect("a robot");
    if robot.restore(bytes).is_ok() {
        run_ticks(&mut robot);
    }
}

/// Three ticks with a frame and a scan. Every desired speed must be finite.
pub(crate) fn run_ticks(robot: &mut Robot) {
    let camera = ROBOT.camera;
    let geometry = ScanGeometry { beams: 31, ..ScanGeometry::UTM_30LX };
    let image: Vec<u8> =
        (0..camera.width * camera.height * 3).map(|at| (at * at % 251) as u8).collect();
    for tick in 0..TICKS {
        // Later than every time in the robot's state, otherwise the tick is refused.
        let time_ns = u64::MAX / 2 + tick * 100_000_000;
        let scan = LaserScan { time_ns, geometry, ranges: vec![Range::Hit(1.0); geometry.beams] };
        let frame = ImageView::rgb8(camera.width, camera.height, &image).ok();
        let wheel = WheelFeedback { time_ns, ..WheelFeedback::default() };
        let input = TickInput {
            tick,
            time_ns,
            wheel,
            scan: Some(&scan),
            scan_odom: wheel.odom,
            imu: Some(ImuInput {
                gaps: 0,
                yaw_rad: 0.01 * tick as f64,
                yaw_at_scan_rad: 0.01 * tick as f64,
                tilt_rad: Some(0.0),
            }),
            outside: Some(OutsideInput {
                outside: OutsidePose { time_ns, pose: Pose2::new(0.01 * tick as f64, 0.0, 0.0) },
                wheel_odom: wheel.odom,
            }),
            frame,
            truth: None,
            task: None,
            areas: &[],
            orders: &[],
            safety: &SafetyReport::default(),
        };
        let recorded = RecordedTick::capture(&input, None).expect("an RGB8 frame");
        let decision = recompute(robot, &recorded).expect("the frame has its size");
        let desired = decision.desired;
        assert!(desired.linear_mps.is_finite() && desired.angular_radps.is_finite());
    }
}
