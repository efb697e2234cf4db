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
const LONGEST_S: f64 = 800.0;

/// How a robot changes.
struct Disturbance {
    name: &'static str,
    /// What it should be called.
    what: Watched,
    needs_frames: bool,
    apply: fn(&mut TruthSection),
}

const DISTURBANCES: [Disturbance; 8] = [
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
        name: "camera roll 3 degrees",
        what: Watched::CameraRoll,
        needs_frames: true,
        apply: |truth| truth.camera_roll_deg = 3.0,
    },
    Disturbance {
        name: "camera yaw 10 degrees",
        what: Watched::CameraYaw,
        needs_frames: true,
        apply: |truth| truth.camera_yaw_deg = 10.0,
    },
    Disturbance {
        name: "camera latency 10 ms",
        what: Watched::CameraLatency,
        needs_frames: true,
        apply: |truth| truth.camera_late_s = 0.01,
    },
    Disturbance {
        name: "LiDAR latency 10 ms",
        what: Watched::LidarLatency,
        needs_frames: true,
        apply: |truth| truth.lidar_late_s = 0.01,
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
        "| change | robots | named within 10 m | named wrongly | distance p50 | distance p90 | other reports |"
    );
    println!("|---|---|---|---|---|---|---|");
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

/// What the robots of one disturbance reported.
#[derive(Default)]
struct Row {
    robots: usize,
    /// After the change, the first report was this one, after these distances, metres; or another.
    named_m: Vec<f64>,
    wrong: usize,
    /// Every other report, before and after.
    other: usize,
}

impl Row {
    fn add(&mut self, what: Watched, reports: &Reports) {
        self.robots += 1;
        self.other += reports.changes.len();
        let first = reports.changes.iter().find(|(at_m, _)| *at_m > CHANGES_AFTER_M);
        let Some((at_m, change)) = first else { return };
        self.other -= 1;
        if change.what == what {
            self.named_m.push(at_m - CHANGES_AFTER_M);
        } else {
            self.wrong += 1;
        }
    }

    fn print(&mut self, name: &str) {
        self.named_m.sort_by(f64::total_cmp);
        let [p50, p90] = [0.5, 0.9].map(|share| {
            let last = self.named_m.len().saturating_sub(1) as f64;
            let distance_m = self.named_m.get((share * last).round() as usize);
            distance_m.map_or(String::new(), |distance_m| format!("{distance_m:.1} m"))
        });
        let Self { robots, named_m, wrong, other } = self;
        let named = named_m.len();
        println!("| {name} | {robots} | {named} | {wrong} | {p50} | {p90} | {other} |");
    }
}

fn row(disturbance: &Disturbance, seeds: Range<u64>) -> Result<()> {
    let mut row = Row::default();
    for seed in seeds {
        let mut config = Config::default();
        (disturbance.apply)(&mut config.simulator.truth);
        config.simulator.truth.changes_after_m = CHANGES_AFTER_M;
        let most_m = CHANGES_AFTER_M + NOTICES_WITHIN_M;
        let reports = reports(&config, seed, disturbance.needs_frames, LONGEST_S, most_m)?;
        row.add(disturbance.what, &reports);
    }
    row.print(disturbance.name);
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
        let minutes = robots as f64 * seconds / 60.0;
        println!(
            "| none ({sensors}, {minutes:.0} min, {driven_m:.0} m) | {robots} | | | | | {changes} |"
        );
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
