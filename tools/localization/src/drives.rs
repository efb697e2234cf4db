//! Errors and costs of localization along drives in simulated homes: `localization --drives`.
//!
//! A robot with a scanner of 1,081 beams and the wheels of an ordinary base drives a tour of all reachable floor, at 0.2 m/s and 10 Hz. The
//! simulator's truth only judges.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use hal::{Pose2, wrap_angle};
use simulator::{OpenOptions, World};

use crate::kiss_icp::KissIcp;
use crate::relocalize::quantile;
use crate::rover::{Rover, part_of};
use crate::tour;

/// Scans between two poses of the tour: 0.02 m, or 1.9 degrees.
const SCANS_OF_STEP: usize = 3;
/// Ticks of an hour.
const HOUR: usize = 36_000;
/// Distance between the two poses of a pair, metres.
const PAIR_M: f64 = 0.2;

pub const COLUMNS: [&str; 11] = [
    "simulated home",
    "scans",
    "driven (m)",
    "0.2 m apart, rms (mm / mrad)",
    "with a gyroscope (mm / mrad)",
    "wheels alone (mm / mrad)",
    "scan to pose, ms p50 / p99",
    "closing loops, ms a tick p99 / max",
    "memory (MiB)",
    "KISS-ICP: mm / mrad",
    "KISS-ICP: ms p50 / p99",
];

/// Where the robot was, where it believed to be, and where its wheels said.
#[derive(Clone, Copy)]
struct Step {
    truth: Pose2,
    t_odom_base: Pose2,
    /// The same with a gyroscope.
    with_imu: Pose2,
    wheel: Pose2,
    /// By KISS-ICP, if it runs beside.
    peer: Option<Pose2>,
}

/// What one drive showed.
#[derive(Default)]
struct Drive {
    steps: Vec<Step>,
    driven_m: f64,
    /// Milliseconds of updates that only tracked the scan.
    tracking_ms: Vec<f64>,
    /// Milliseconds that other updates took beyond the median of these.
    closing_ms: Vec<f64>,
    memory_mib: f64,
    /// Milliseconds of KISS-ICP for the same scans; empty if it does not run.
    peer_ms: Vec<f64>,
}

/// The row of a drive of one hour, or of one lap if `laps_once`.
///
/// # Errors
/// A home that cannot be opened.
pub fn row(home: &str, laps_once: bool) -> Result<[String; 11]> {
    let world = Arc::new(World::open(home, &OpenOptions::default()).context(home.to_owned())?);
    let drive = drive(&world, laps_once)?;
    let [metres, radians] = errors(&drive.steps, |step| step.t_odom_base);
    let [imu_metres, imu_radians] = errors(&drive.steps, |step| step.with_imu);
    let [wheel_metres, wheel_radians] = errors(&drive.steps, |step| step.wheel);
    let [peer_metres, peer_radians] =
        errors(&drive.steps, |step| step.peer.unwrap_or(Pose2::IDENTITY));
    let of_lap = |cell: String| if laps_once { cell } else { String::new() };
    let of_peer = |cell: String| if drive.peer_ms.is_empty() { String::new() } else { cell };
    let ms = |values: &[f64], share| quantile(values, share);
    Ok([
        home.to_owned(),
        drive.steps.len().to_string(),
        format!("{:.0}", drive.driven_m),
        format!("{:.1} / {:.1}", 1e3 * metres, 1e3 * radians),
        of_lap(format!("{:.1} / {:.1}", 1e3 * imu_metres, 1e3 * imu_radians)),
        format!("{:.1} / {:.1}", 1e3 * wheel_metres, 1e3 * wheel_radians),
        format!("{:.2} / {:.2}", ms(&drive.tracking_ms, 0.5), ms(&drive.tracking_ms, 0.99)),
        format!("{:.2} / {:.2}", ms(&drive.closing_ms, 0.99), ms(&drive.closing_ms, 1.0)),
        if laps_once { String::new() } else { format!("{:.1}", drive.memory_mib) },
        of_peer(format!("{:.1} / {:.1}", 1e3 * peer_metres, 1e3 * peer_radians)),
        of_peer(format!("{:.2} / {:.2}", ms(&drive.peer_ms, 0.5), ms(&drive.peer_ms, 0.99))),
    ])
}

fn drive(world: &Arc<World>, laps_once: bool) -> Result<Drive> {
    let mut rover = Rover::new(world, 1)?;
    let mut localizer = rover.localizer()?;
    let mut second = if laps_once { Some(rover.localizer()?) } else { None };
    // An hour would take it long, and say nothing that a lap does not.
    let mut peer = if laps_once { KissIcp::start()? } else { None };
    let mut drive = Drive::default();
    let mut busy_ms = Vec::new();
    let before_mib = resident_mib();
    let mut lap = tour::through(world.floor_plan(), rover.truth());
    while drive.steps.len() < HOUR {
        for pose in between(&lap) {
            rover.move_to(pose)?;
            let is_closing = localizer.is_closing();
            let start = Instant::now();
            let estimate = rover.update(&mut localizer);
            let took_ms = start.elapsed().as_secs_f64() * 1e3;
            match is_closing || localizer.is_closing() {
                true => busy_ms.push(took_ms),
                false => drive.tracking_ms.push(took_ms),
            }
            if let Some(last) = drive.steps.last() {
                drive.driven_m += last.truth.distance_m(&pose);
            }
            let with_imu = second.as_mut().map(|second| rover.update_with_imu(second));
            let mut step = Step {
                truth: pose,
                t_odom_base: estimate.t_odom_base,
                with_imu: with_imu.map_or(Pose2::IDENTITY, |estimate| estimate.t_odom_base),
                wheel: rover.wheel(),
                peer: None,
            };
            if let Some(peer) = &mut peer {
                let (took_ms, t_first_laser) = peer.update(rover.scan())?;
                drive.peer_ms.push(took_ms);
                let t_base_laser = rover.t_base_laser();
                let t_first_base = t_first_laser.compose(&t_base_laser.inverse());
                step.peer = Some(t_base_laser.compose(&t_first_base));
            }
            drive.steps.push(step);
        }
        if laps_once {
            break;
        }
        // The next lap goes the other way.
        lap.reverse();
    }
    let tracking_ms = quantile(&drive.tracking_ms, 0.5);
    drive.closing_ms = busy_ms.iter().map(|ms| (ms - tracking_ms).max(0.0)).collect();
    let steps_mib = (drive.steps.capacity() * size_of::<Step>()) as f64 / f64::from(1 << 20);
    drive.memory_mib = (resident_mib() - before_mib - steps_mib).max(0.0);
    Ok(drive)
}

/// The poses of a tour, with more of them in between.
fn between(lap: &[Pose2]) -> Vec<Pose2> {
    let legs = lap.iter().zip(&lap[1..]);
    let mut poses = lap.first().copied().into_iter().collect::<Vec<_>>();
    for (from, to) in legs {
        let motion = from.inverse().compose(to);
        for part in 1..=SCANS_OF_STEP {
            poses.push(from.compose(&part_of(&motion, part as f64 / SCANS_OF_STEP as f64)));
        }
    }
    poses
}

/// Root mean square errors of the motion between poses 0.2 m apart: metres and radians.
fn errors(steps: &[Step], pose: impl Fn(&Step) -> Pose2) -> [f64; 2] {
    let mut squares = [0.0; 2];
    let mut count = 0.0_f64;
    let mut second = 0;
    for first in steps {
        while second < steps.len() && steps[second].truth.distance_m(&first.truth) < PAIR_M {
            second += 1;
        }
        let Some(later) = steps.get(second) else { break };
        let truth = first.truth.inverse().compose(&later.truth);
        let estimated = pose(first).inverse().compose(&pose(later));
        let error = truth.inverse().compose(&estimated);
        squares[0] += error.x_m.powi(2) + error.y_m.powi(2);
        squares[1] += wrap_angle(error.yaw_rad).powi(2);
        count += 1.0;
    }
    squares.map(|sum| (sum / count.max(1.0)).sqrt())
}

/// Memory of this process that is in use, MiB.
fn resident_mib() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = statm.split_whitespace().nth(1).and_then(|pages| pages.parse::<f64>().ok());
    pages.unwrap_or(f64::NAN) * 4096.0 / f64::from(1 << 20)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_those_of_the_motion_and_not_of_the_place() {
        let shift = Pose2::new(3.0, -1.0, 0.7);
        let steps: Vec<Step> = (0..100)
            .map(|step| Pose2::new(0.02 * f64::from(step), 0.0, 0.0))
            .map(|truth| Step {
                truth,
                t_odom_base: shift.compose(&truth),
                with_imu: Pose2::IDENTITY,
                wheel: Pose2::new(1.01 * truth.x_m, 0.0, 0.0),
                peer: None,
            })
            .collect();
        let [metres, radians] = errors(&steps, |step| step.t_odom_base);
        assert!(metres < 1e-12 && radians < 1e-12);
        let [metres, _] = errors(&steps, |step| step.wheel);
        // A pair is 0.2 m apart, or one step more.
        assert!((0.00199..0.00221).contains(&metres), "1 % of 0.2 m: {metres}");
    }

    #[test]
    fn a_tour_in_small_steps_passes_the_poses_of_the_tour() {
        let lap = [Pose2::IDENTITY, Pose2::new(0.06, 0.0, 0.0), Pose2::new(0.06, 0.0, 0.1)];
        let poses = between(&lap);
        assert_eq!(poses.len(), 7);
        assert!(poses[3].distance_m(&lap[1]) < 1e-12);
        assert!((poses[6].yaw_rad - 0.1).abs() < 1e-12);
    }
}
