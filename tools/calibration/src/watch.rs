//! Robots that change while they drive, and what each of them finds of that itself.

use std::ops::Range;
use std::sync::Arc;

use anyhow::Result;
use firmware_host::config::{Config, TruthSection};
use firmware_host::setup::Mission;
use runtime::calibration_watch::{Change, Watched};
use runtime::event::Event;
use runtime::exploration::PolicyKind;
use runtime::recording::changed;
use runtime::robot::{DepthSource, Robot};
use runtime::session::recompute;
use simulator::{OpenOptions, World};

use crate::HOMES;
use crate::trial::{Length, drive};

/// The robot changes after this distance, and then has this distance to notice it, metres.
const CHANGES_AFTER_M: f64 = 15.0;
const NOTICES_WITHIN_M: f64 = 10.0;
/// No drive of that distance takes longer, seconds.
const LONGEST_S: f64 = 400.0;

/// A way in which a robot changes.
struct Disturbance {
    name: &'static str,
    /// What it should be called.
    what: Watched,
    needs_frames: bool,
    apply: fn(&mut TruthSection),
}

const DISTURBANCES: [Disturbance; 6] = [
    Disturbance {
        name: "one wheel 1 %",
        what: Watched::WheelHeading,
        needs_frames: false,
        apply: |truth| truth.left_wheel_percent = 1.0,
    },
    Disturbance {
        name: "both wheels 1 %",
        what: Watched::WheelDistance,
        needs_frames: false,
        apply: |truth| (truth.left_wheel_percent, truth.right_wheel_percent) = (1.0, 1.0),
    },
    Disturbance {
        name: "LiDAR yaw 1 degree",
        what: Watched::LidarYaw,
        needs_frames: false,
        apply: |truth| truth.lidar_yaw_deg = 1.0,
    },
    Disturbance {
        name: "camera pitch 1 degree",
        what: Watched::CameraPitch,
        needs_frames: true,
        apply: |truth| truth.camera_pitch_down_deg = 1.0,
    },
    Disturbance {
        name: "camera yaw 1 degree",
        what: Watched::CameraYaw,
        needs_frames: true,
        apply: |truth| truth.camera_yaw_deg = 1.0,
    },
    Disturbance {
        name: "camera latency 10 ms",
        what: Watched::CameraLatency,
        needs_frames: true,
        apply: |truth| truth.camera_late_s = 0.01,
    },
];

/// What one robot reported, with the distance at which it did.
struct Reports {
    driven_m: f64,
    changes: Vec<(f64, Change)>,
}

/// Measures and prints a table in Markdown. Undisturbed robots drive for `seconds`.
///
/// # Errors
/// A scene that cannot be opened.
pub fn measure(seeds: Range<u64>, only: Option<&str>, seconds: f64) -> Result<()> {
    println!(
        "| change | robots | detected within 10 m | named rightly | median way | other reports |"
    );
    println!("|---|---|---|---|---|---|");
    for disturbance in &DISTURBANCES {
        if only.is_none_or(|only| disturbance.name.contains(only)) {
            row(disturbance, seeds.clone())?;
        }
    }
    if only.is_none_or(|only| only == "none") {
        undisturbed(seeds, seconds)?;
    }
    Ok(())
}

fn row(disturbance: &Disturbance, seeds: Range<u64>) -> Result<()> {
    let robots = seeds.clone().count();
    let (mut detected, mut named, mut other, mut ways_m) = (0, 0, 0, Vec::new());
    for seed in seeds {
        let mut config = Config::default();
        (disturbance.apply)(&mut config.simulator.truth);
        config.simulator.truth.changes_after_m = CHANGES_AFTER_M;
        let most_m = CHANGES_AFTER_M + NOTICES_WITHIN_M;
        let reports = reports(&config, seed, disturbance.needs_frames, LONGEST_S, most_m)?;
        let mut after = reports.changes.iter().filter(|(at_m, _)| *at_m > CHANGES_AFTER_M);
        if let Some((at_m, change)) = after.next() {
            detected += 1;
            named += usize::from(change.what == disturbance.what);
            ways_m.push(at_m - CHANGES_AFTER_M);
        }
        other += reports.changes.len().saturating_sub(1);
    }
    ways_m.sort_by(f64::total_cmp);
    let median =
        ways_m.get(ways_m.len() / 2).map_or(String::new(), |way_m| format!("{way_m:.1} m"));
    println!("| {} | {robots} | {detected} | {named} | {median} | {other} |", disturbance.name);
    Ok(())
}

fn undisturbed(seeds: Range<u64>, seconds: f64) -> Result<()> {
    for needs_frames in [false, true] {
        let (mut driven_m, mut changes) = (0.0, 0);
        let robots = seeds.clone().count();
        for seed in seeds.clone() {
            let reports = reports(&Config::default(), seed, needs_frames, seconds, f64::INFINITY)?;
            driven_m += reports.driven_m;
            changes += reports.changes.len();
        }
        let sensors = if needs_frames { "everything" } else { "wheels and LiDAR" };
        println!("| none ({sensors}) | {robots} | | | {driven_m:.0} m in all | {changes} |");
    }
    Ok(())
}

/// Drives robot number `seed` for `seconds` or `most_m` metres.
fn reports(config: &Config, seed: u64, frames: bool, seconds: f64, most_m: f64) -> Result<Reports> {
    let scene = format!("{}?seed={seed}", HOMES[seed as usize % HOMES.len()]);
    let world = Arc::new(World::open(&scene, &OpenOptions::default())?);
    let mission = Mission { policy: PolicyKind::Active, depth_source: DepthSource::Coarse, seed };
    let mut config = config.clone();
    config.dense.enabled = false;
    let mut robot = Robot::new(config.robot(&mission), None)?;
    let length = Length { drive_s: seconds, frames_s: if frames { seconds } else { 0.0 } };
    let mut reports = Reports { driven_m: 0.0, changes: Vec::new() };
    let mut last = None;
    drive(&world, &config, seed, length, |input| {
        let here = input.wheel.odom;
        reports.driven_m +=
            last.replace(here).map_or(0.0, |last: hal::Pose2| last.distance_m(&here));
        let decision = recompute(&mut robot, &input)?;
        for event in &decision.events {
            if let Event::CalibrationChanged { change } = event {
                eprintln!("robot {seed} at {:.1} m: {}", reports.driven_m, changed(change));
                reports.changes.push((reports.driven_m, *change));
            }
        }
        Ok(reports.driven_m < most_m)
    })?;
    if std::env::var_os("MEASURED").is_some() {
        for measured in robot.calibration().measured() {
            eprintln!("robot {seed}: {measured:?}");
        }
    }
    Ok(reports)
}
