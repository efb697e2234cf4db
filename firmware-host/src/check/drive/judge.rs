//! What the safety plane assumes, beside what was measured.

use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use hal::wrap_angle;

use super::assumed::Assumed;
use super::measure::{Measured, Motion};
use crate::report::fit;

/// Encoders and the age of their readings make these errors, metres and seconds.
const DISTANCE_ERROR_M: f64 = 0.005;
const TIME_ERROR_S: f64 = 0.01;
/// Wheels and scanner may differ by this share of a motion. The witness of the safety plane tolerates more.
const SCALE_ERROR: f64 = 0.15;
/// At the end of a metre, a scanner that is turned by this angle sees obstacles 5 cm aside of their place.
const YAW_LIMIT_DEG: f64 = 3.0;

/// One measured number beside the assumed one.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    pub what: &'static str,
    pub assumed: String,
    pub measured: String,
    pub is_worse: bool,
    /// What to do if it is worse.
    pub advice: String,
}

/// All judgements, in the order of the table.
pub fn all(measured: &Measured, assumed: &Assumed) -> Vec<Judgement> {
    vec![
        reaction(measured, assumed),
        braking(measured, assumed),
        roll_out(measured, assumed),
        way_ahead(measured),
        rotation("rotation to the left", &measured.left),
        rotation("rotation to the right", &measured.right),
        lidar_yaw(measured, assumed),
    ]
}

/// The table, and the advice below it.
pub fn table(judgements: &[Judgement]) -> String {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["", "assumed", "measured", ""]);
    for judgement in judgements {
        let mark = if judgement.is_worse { "WORSE" } else { "good" };
        table.add_row([judgement.what, &judgement.assumed, &judgement.measured, mark]);
    }
    let mut text = fit::table(&table, fit::columns());
    for judgement in judgements.iter().filter(|judgement| judgement.is_worse) {
        text += &format!("\n  ! {}: {}", judgement.what, judgement.advice);
    }
    text
}

fn reaction(measured: &Measured, assumed: &Assumed) -> Judgement {
    let measured_s = assumed.sight_s + measured.response_s;
    let assumed_s = assumed.safety.reaction_s;
    Judgement {
        what: "reaction time",
        assumed: format!("{assumed_s:.2} s"),
        measured: format!(
            "{measured_s:.2} s ({:.2} s of the scanner, {:.2} s of the wheels; they start after {:.2} s)",
            assumed.sight_s, measured.response_s, measured.start_s
        ),
        is_worse: is_above(measured_s, assumed_s + TIME_ERROR_S),
        advice: format!("set `run.reaction_s = {:.2}`", rounded_up(measured_s)),
    }
}

fn braking(measured: &Measured, assumed: &Assumed) -> Judgement {
    let speed_mps = measured.speed_mps;
    let until_braking_m = speed_mps * measured.response_s;
    let assumed_m = until_braking_m + speed_mps * speed_mps / (2.0 * assumed.safety.brake_mps2);
    let braking_m = (measured.braking_m - until_braking_m).max(1e-3);
    let brake_mps2 = speed_mps * speed_mps / (2.0 * braking_m);
    Judgement {
        what: "braking distance",
        assumed: format!("{assumed_m:.3} m at {speed_mps:.2} m/s"),
        measured: format!("{:.3} m", measured.braking_m),
        is_worse: is_above(measured.braking_m, assumed_m + DISTANCE_ERROR_M),
        advice: format!(
            "set `run.brake_mps2 = {:.2}`, or tune the controllers",
            (brake_mps2 * 100.0).floor() / 100.0
        ),
    }
}

/// The distance until standstill after the program died, at the speed of ordinary driving. Wheels that coast or brake lose their
/// energy evenly, so the distance grows with the square of the speed.
fn roll_out(measured: &Measured, assumed: &Assumed) -> Judgement {
    let faster = assumed.top_mps / measured.last_speed_mps.max(1e-3);
    let rolls_m = measured.roll_out_m * faster * faster.max(1.0);
    let kept_m =
        assumed.safety.stop_distance_m + assumed.safety.stopping_distance_m(assumed.top_mps);
    let why = if assumed.coasts { " An ODrive coasts when its commands end." } else { "" };
    Judgement {
        what: "roll-out without commands",
        assumed: format!("{kept_m:.2} m at {:.2} m/s", assumed.top_mps),
        measured: format!(
            "{rolls_m:.2} m ({:.3} m at {:.2} m/s)",
            measured.roll_out_m, measured.last_speed_mps
        ),
        is_worse: is_above(rolls_m, kept_m),
        advice: format!(
            "if the program dies just before it would brake, the robot touches the obstacle.{why} Set `safety.stop_distance_m = {:.2}`, \
             or drive slower",
            rounded_up(rolls_m - assumed.safety.stopping_distance_m(assumed.top_mps))
        ),
    }
}

fn way_ahead(measured: &Measured) -> Judgement {
    let wheels_m = measured.ahead.wheels.x_m;
    let laser_m = measured.ahead.laser.map(|laser| laser.x_m.hypot(laser.y_m));
    let differs = laser_m.is_none_or(|laser_m| {
        is_above((laser_m - wheels_m).abs(), SCALE_ERROR * wheels_m.abs() + DISTANCE_ERROR_M)
    });
    let advice = match laser_m {
        None => NOT_SEEN.to_owned(),
        Some(laser_m) => format!(
            "the wheels report {:.0} % of the true distance: check `wheel_radius_m`, `gear_ratio`, and `invert_left` and `invert_right` if \
             the robot rotated instead",
            100.0 * wheels_m / laser_m.max(1e-3)
        ),
    };
    Judgement {
        what: "way ahead",
        assumed: format!("{wheels_m:.3} m by the wheels"),
        measured: seen(laser_m, |metres| format!("{metres:.3} m by the scanner")),
        is_worse: wheels_m < DISTANCE_ERROR_M || differs,
        advice,
    }
}

const NOT_SEEN: &str = "the scanner saw too little of the room: put the robot where walls or furniture are within 5 m on two sides";

fn rotation(what: &'static str, motion: &Motion) -> Judgement {
    let (wheels_rad, laser_rad) = motion.yaws_rad();
    let ratio = laser_rad.map(|laser_rad| laser_rad / wheels_rad);
    let advice = match ratio {
        None => NOT_SEEN.to_owned(),
        Some(ratio) => format!("multiply `track_m` by {:.2}", 1.0 / ratio),
    };
    Judgement {
        what,
        assumed: format!("{:.0} degrees by the wheels", wheels_rad.to_degrees()),
        measured: seen(laser_rad, |rad| format!("{:.0} degrees by the scanner", rad.to_degrees())),
        is_worse: ratio.is_none_or(|ratio| is_above((ratio - 1.0).abs(), SCALE_ERROR)),
        advice,
    }
}

/// Direction of the scanner's front, counter-clockwise from forward, degrees: driving straight ahead, it sees the direction of travel
/// to the right by as much.
pub fn lidar_yaw_deg(measured: &Measured) -> Option<f64> {
    let laser = measured.ahead.laser?;
    let wheels = &measured.ahead.wheels;
    let turned_rad = wheels.y_m.atan2(wheels.x_m) - laser.y_m.atan2(laser.x_m);
    Some(wrap_angle(turned_rad).to_degrees())
}

fn lidar_yaw(measured: &Measured, assumed: &Assumed) -> Judgement {
    let yaw_deg = lidar_yaw_deg(measured);
    let advice = yaw_deg.map_or_else(
        || NOT_SEEN.to_owned(),
        |yaw_deg| format!("set `lidar.yaw_deg = {yaw_deg:.1}`"),
    );
    Judgement {
        what: "yaw of the LiDAR",
        assumed: format!("{:.1} degrees, within {YAW_LIMIT_DEG:.0}", assumed.lidar_yaw_deg),
        measured: seen(yaw_deg, |yaw_deg| format!("{yaw_deg:.1} degrees")),
        is_worse: yaw_deg
            .is_none_or(|yaw_deg| is_above((yaw_deg - assumed.lidar_yaw_deg).abs(), YAW_LIMIT_DEG)),
        advice,
    }
}

/// Whether a measured value is above its limit. NaN is.
fn is_above(value: f64, limit: f64) -> bool {
    value.is_nan() || value > limit
}

fn rounded_up(value: f64) -> f64 {
    (value * 100.0).ceil() / 100.0
}

fn seen(value: Option<f64>, words: impl FnOnce(f64) -> String) -> String {
    value.map_or_else(|| "not measured".to_owned(), words)
}
