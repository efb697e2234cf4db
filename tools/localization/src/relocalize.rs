//! Trials of finding a lost robot, in simulated homes: `localization --relocalize`.
//!
//! In each home a robot first maps all reachable floor. Then it is put at random places and restarted in that
//! map; it rotates on the spot as the robot does. A place that it accepts is compared with the truth.

use std::sync::Arc;

use anyhow::{Context, Result};
use hal::{Pose2, wrap_angle};
use runtime::localization::{Estimate, LostReason};
use simulator::{OpenOptions, World};

use crate::rover::{Rover, STEP_NS};
use crate::tour;

/// Homes that are built in, with seeds that no default uses.
pub const HOMES: [&str; 10] = [
    "builtin:apartment?seed=1",
    "builtin:apartment?seed=2",
    "builtin:apartment?seed=5",
    "builtin:apartment?seed=6",
    "builtin:house?seed=1",
    "builtin:house?seed=2",
    "builtin:house?seed=5",
    "builtin:office?seed=1",
    "builtin:office?seed=2",
    "builtin:office?seed=5",
];
/// An accepted place that is further off than this is wrong.
const WRONG_M: f64 = 0.25;
const WRONG_RAD: f64 = 0.0873;
/// Rotation between scans: a robot that rotates at 20 degrees per second.
pub const STEP_RAD: f64 = 0.035;
/// Steps of a trial: two rotations.
pub const STEPS: usize = 360;
/// A trial's start keeps this distance from furniture, metres.
pub const CLEARANCE_M: f64 = 0.25;

/// Results of the trials in one home.
#[derive(Debug, Default)]
pub struct Results {
    pub trials: usize,
    pub found: usize,
    /// Found with this many scans that were searched for, or fewer.
    pub within_3_scans: usize,
    pub wrong: usize,
    /// Errors of the places that were accepted, metres.
    errors_m: Vec<f64>,
    /// Seconds until then, in the robot's time.
    seconds: Vec<f64>,
}

impl Results {
    /// A row of the table.
    pub fn row(&self, home: &str) -> [String; 7] {
        let [errors, seconds] = if self.found == 0 {
            [const { String::new() }; 2]
        } else {
            [
                format!(
                    "{:.3} / {:.3}",
                    quantile(&self.errors_m, 0.5),
                    quantile(&self.errors_m, 1.0)
                ),
                format!(
                    "{:.1} / {:.1}",
                    quantile(&self.seconds, 0.5),
                    quantile(&self.seconds, 0.95)
                ),
            ]
        };
        [
            home.to_owned(),
            self.trials.to_string(),
            self.found.to_string(),
            self.within_3_scans.to_string(),
            self.wrong.to_string(),
            errors,
            seconds,
        ]
    }

    pub fn add(&mut self, other: &Self) {
        self.trials += other.trials;
        self.found += other.found;
        self.within_3_scans += other.within_3_scans;
        self.wrong += other.wrong;
        self.errors_m.extend(&other.errors_m);
        self.seconds.extend(&other.seconds);
    }
}

/// Whether a place that was accepted is another one than the truth, in `map`.
pub fn is_wrong(truth: &Pose2, estimate: &Estimate) -> bool {
    let error = truth.inverse().compose(&estimate.t_map_base());
    error.x_m.hypot(error.y_m) > WRONG_M || wrap_angle(error.yaw_rad).abs() > WRONG_RAD
}

pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1) as f64;
    sorted.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
}

/// A home, and what a robot remembers that has been everywhere in it.
pub struct MappedHome {
    world: Arc<World>,
    memory: Vec<u8>,
    t_map_world: Pose2,
}

/// Maps a home.
///
/// # Errors
/// A home that cannot be opened.
pub fn map(home: &str) -> Result<MappedHome> {
    let world = Arc::new(World::open(home, &OpenOptions::default()).context(home.to_owned())?);
    let mut rover = Rover::new(&world, 1)?;
    let mut localizer = rover.localizer()?;
    let t_map_world = rover.truth().inverse();
    let mut lost = 0;
    for pose in tour::through(world.floor_plan(), rover.truth()) {
        rover.move_to(pose)?;
        let estimate = rover.update(&mut localizer);
        if estimate.whereabouts.lost().is_some() {
            lost += 1;
            localizer.continue_by_wheels();
        }
    }
    localizer.settle();
    let end = t_map_world.compose(&rover.truth());
    let error_m = localizer.estimate().t_map_base().distance_m(&end);
    eprintln!(
        "{home}: {} submaps, {} closures, end {error_m:.3} m off, lost {lost} times meanwhile",
        localizer.submap() + 1,
        localizer.closures()
    );
    Ok(MappedHome { world, memory: localizer.snapshot(), t_map_world })
}

/// Restarts a robot at random places of `home` in the map of `mapped`, which may be of another home: then every place that it
/// accepts is wrong.
///
/// # Errors
/// A snapshot that is refused: a defect.
pub fn trials(home: &MappedHome, mapped: &MappedHome, count: usize) -> Result<Results> {
    let is_other = !std::ptr::eq(home, mapped);
    let mut results = Results { trials: count, ..Results::default() };
    let plan = home.world.floor_plan();
    let mut seeds = (0_u64..).filter(|seed| {
        let pose = plan.random_pose(*seed);
        plan.clearance_m(pose.x_m, pose.y_m) > CLEARANCE_M
    });
    for _ in 0..count {
        let seed = seeds.next().unwrap_or_default();
        let mut rover = Rover::new(&home.world, seed)?;
        let mut localizer = rover.localizer()?;
        localizer.restore(&mapped.memory)?;
        localizer.lose(LostReason::Loaded);
        rover.put(plan.random_pose(seed));
        for step in 0..STEPS {
            let rotation = if step == 0 { 0.0 } else { STEP_RAD };
            rover.move_to(rover.truth().compose(&Pose2::new(0.0, 0.0, rotation)))?;
            let estimate = rover.update(&mut localizer);
            if estimate.whereabouts.lost().is_none() {
                let truth = home.t_map_world.compose(&rover.truth());
                let error_m = truth.distance_m(&estimate.t_map_base());
                let is_off = is_wrong(&truth, &estimate);
                results.found += 1;
                results.within_3_scans += usize::from(localizer.scans_searched() <= 3);
                results.wrong += usize::from(is_off || is_other);
                results.errors_m.push(error_m);
                results.seconds.push((step + 1) as f64 * STEP_NS as f64 * 1e-9);
                break;
            }
        }
    }
    Ok(results)
}
