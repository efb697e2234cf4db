//! A robot whose scanner rotates slowly drives towards a wall, in virtual time.

use super::{Plan, Request, SafetyConfig, SafetyInput, SafetyPlane, SafetyState};
use hal::{LaserScan, Pose2, Range, ScanGeometry, Twist2, WheelFeedback};

const STEP_NS: u64 = 10_000_000;
const STEP_S: f64 = 0.01;
/// Time that the end of a scan takes to the safety plane.
const CABLE_NS: u64 = 30_000_000;
const BRAKE_MPS2: f64 = 1.0;
const RADIUS_M: f64 = 0.16;
const WALL_M: f64 = 5.0;

/// A scanner of 600 beams with this period.
fn geometry(period_ns: u64) -> ScanGeometry {
    ScanGeometry {
        angle_min_rad: -std::f64::consts::PI,
        angle_increment_rad: std::f64::consts::TAU / 600.0,
        beams: 600,
        range_min_m: 0.15,
        range_max_m: 12.0,
        period_ns,
        clockwise: true,
    }
}

fn config(reaction_s: f64, period_ns: u64) -> SafetyConfig {
    SafetyConfig {
        footprint_radius_m: RADIUS_M,
        reaction_s,
        brake_mps2: BRAKE_MPS2,
        scan_timeout_s: 2.3e-9 * period_ns as f64,
        good_scans: 3,
        feedback_timeout_s: 0.1,
        plan_timeout_s: 0.5,
        period_s: STEP_S,
        ..SafetyConfig::default()
    }
}

/// All beams as measured at the beginning of the scan: the oldest that they can be.
fn scan(time_ns: u64, x_m: f64, geometry: ScanGeometry) -> LaserScan {
    let ranges = (0..geometry.beams).map(|beam| {
        let cos = geometry.angle_rad(beam).cos();
        if cos > 0.1 { Range::Hit(((WALL_M - x_m) / cos) as f32) } else { Range::Hit(4.0) }
    });
    LaserScan { time_ns, geometry, ranges: ranges.collect() }
}

/// How the approach to the wall went.
struct Approach {
    fastest_mps: f64,
    /// Distance between outline and wall when the robot stands, metres.
    gap_m: f64,
}

/// Drives towards the wall as fast as the safety plane allows, until the robot stands.
fn approach(config: SafetyConfig, period_ns: u64) -> Approach {
    let geometry = geometry(period_ns);
    let mut plane = SafetyPlane::new(config);
    let [mut x_m, mut speed_mps, mut fastest_mps] = [0.0, 0.0_f64, 0.0_f64];
    let mut underway: Option<LaserScan> = None;
    let mut measuring = scan(0, x_m, geometry);
    for step in 0..3000 {
        let now_ns = step * STEP_NS;
        if now_ns >= measuring.time_ns + period_ns {
            let next = scan(measuring.time_ns + period_ns, x_m, geometry);
            underway = Some(std::mem::replace(&mut measuring, next));
        }
        let arrived = underway.take_if(|scan| now_ns >= scan.time_ns + period_ns + CABLE_NS);
        let twist = Twist2 { linear_mps: speed_mps, angular_radps: 0.0 };
        let odom = Pose2::new(x_m, 0.0, 0.0);
        let plan = Twist2 { linear_mps: 3.0, angular_radps: 0.0 };
        let output = plane.step(&SafetyInput {
            time_ns: now_ns,
            scan: arrived.as_ref(),
            wheel: Some(WheelFeedback {
                time_ns: now_ns,
                odom,
                twist,
                contact: false,
                cliff: false,
            }),
            base_error: None,
            emergency_stop: false,
            suspended: false,
            plan: Some(Plan { twist: plan, time_ns: now_ns }),
            request: Some(Request::Arm),
        });
        let wanted_mps = output.twist().linear_mps.max(0.0);
        speed_mps = wanted_mps.clamp(speed_mps - BRAKE_MPS2 * STEP_S, speed_mps + 2.0 * STEP_S);
        x_m += speed_mps * STEP_S;
        fastest_mps = fastest_mps.max(speed_mps);
        if fastest_mps > 0.0 && speed_mps <= 0.0 && !matches!(plane.state(), SafetyState::Disarmed)
        {
            break;
        }
    }
    Approach { fastest_mps, gap_m: WALL_M - x_m - RADIUS_M }
}

#[test]
fn a_robot_with_a_slow_scanner_drives_no_faster_than_it_can_stop() {
    for hz in [5.5, 10.0] {
        let period_ns = (1e9 / hz) as u64;
        let reaction_s = 3.0 * 1.15 / hz + 0.03;
        let config = config(reaction_s, period_ns);
        let top_mps = config.top_speed_mps();
        let stop_distance_m = config.stop_distance_m;
        let went = approach(config, period_ns);
        assert!(went.fastest_mps <= top_mps + 1e-9, "{hz} Hz: {}", went.fastest_mps);
        assert!(went.fastest_mps > 0.9 * top_mps, "{hz} Hz: {}", went.fastest_mps);
        assert!(went.gap_m > stop_distance_m - 0.02, "{hz} Hz: {} m left", went.gap_m);
    }
}
