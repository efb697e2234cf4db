//! Trials of robots in homes that their map does not describe well: `localization --separate`.
//!
//! The map holds the first half of a tour, and the robot is put where it has never been; or it holds the whole home, and all furniture
//! was moved since; or it is of another home. The robot searches on the spot, and if it does not find itself, it begins another map,
//! drives a tour from there, and joins both maps where they meet. Every place that it accepts is compared with the truth.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use hal::Pose2;
use runtime::localization::{Localizer, LostReason};
use simulator::{OpenOptions, World};

use crate::relocalize::{CLEARANCE_M, STEP_RAD, STEPS, is_wrong, quantile};
use crate::rover::{Rover, STEP_NS};
use crate::tour;

/// A place counts as never visited at this distance from the path that made the map, metres.
const UNVISITED_M: f64 = 2.5;
/// A robot that has not joined its maps after five minutes of its drive never will, in this trial.
const MOST_STEPS: usize = 3000;

/// What differs from the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Differs {
    /// The map holds the first half of a tour.
    HalfMapped,
    /// All furniture was moved.
    Moved,
    /// The map is of this home: every place in it is wrong.
    OtherHome(&'static str),
}

impl Differs {
    /// What differs in this home, and in words.
    pub fn all(other_home: &'static str) -> [(Self, &'static str); 3] {
        [
            (Self::HalfMapped, "half of it mapped"),
            (Self::Moved, "furniture moved"),
            (Self::OtherHome(other_home), "map of another home"),
        ]
    }
}

/// Results of the trials in one home.
#[derive(Debug, Default)]
pub struct Results {
    trials: usize,
    /// Found on the spot.
    found: usize,
    found_wrongly: usize,
    joined: usize,
    joined_wrongly: usize,
    /// Seconds from the beginning of the second map until both were joined, in the robot's time.
    seconds: Vec<f64>,
    errors_m: Vec<f64>,
    /// Time of each update while there were two maps, milliseconds.
    update_ms: Vec<f64>,
}

pub const COLUMNS: [&str; 9] = [
    "simulated home",
    "trials",
    "found on the spot",
    "wrong",
    "joined in 5 minutes",
    "wrong",
    "seconds p50 / p95",
    "error p50 / max (m)",
    "ms an update p50 / p99",
];

impl Results {
    pub fn row(&self, home: &str) -> [String; 9] {
        let mut seconds = String::new();
        let mut errors = String::new();
        let mut update_ms = String::new();
        if !self.update_ms.is_empty() {
            let [half, most] = [0.5, 0.99].map(|share| quantile(&self.update_ms, share));
            update_ms = format!("{half:.2} / {most:.2}");
        }
        if !self.seconds.is_empty() {
            let [half, most] = [0.5, 0.95].map(|share| quantile(&self.seconds, share));
            seconds = format!("{half:.0} / {most:.0}");
            let [half, most] = [0.5, 1.0].map(|share| quantile(&self.errors_m, share));
            errors = format!("{half:.3} / {most:.3}");
        }
        [
            home.to_owned(),
            self.trials.to_string(),
            self.found.to_string(),
            self.found_wrongly.to_string(),
            self.joined.to_string(),
            self.joined_wrongly.to_string(),
            seconds,
            errors,
            update_ms,
        ]
    }

    pub fn add(&mut self, other: &Self) {
        self.trials += other.trials;
        self.found += other.found;
        self.found_wrongly += other.found_wrongly;
        self.joined += other.joined;
        self.joined_wrongly += other.joined_wrongly;
        self.seconds.extend(&other.seconds);
        self.errors_m.extend(&other.errors_m);
        self.update_ms.extend(&other.update_ms);
    }
}

/// A home, what a robot remembers of it, and places where it can be put.
struct Scene {
    world: Arc<World>,
    memory: Vec<u8>,
    t_map_world: Pose2,
    /// No place of the map is where the robot is.
    is_other: bool,
    seeds: Vec<u64>,
}

impl Scene {
    fn is_wrong(&self, rover: &Rover, localizer: &Localizer) -> bool {
        let truth = self.t_map_world.compose(&rover.truth());
        self.is_other || is_wrong(&truth, &localizer.estimate())
    }
}

/// Trials in `home`, at most `count`.
///
/// # Errors
/// A home that cannot be opened, and a snapshot that is refused.
pub fn trials(home: &str, differs: Differs, count: usize) -> Result<Results> {
    let scene = scene(home, differs, count)?;
    let mut results = Results { trials: scene.seeds.len(), ..Results::default() };
    for seed in &scene.seeds {
        let mut rover = Rover::new(&scene.world, *seed)?;
        let mut localizer = rover.localizer()?;
        localizer.restore(&scene.memory)?;
        localizer.lose(LostReason::Loaded);
        rover.put(scene.world.floor_plan().random_pose(*seed));
        if search(&mut rover, &mut localizer)? {
            results.found += 1;
            results.found_wrongly += usize::from(scene.is_wrong(&rover, &localizer));
            continue;
        }
        localizer.begin_map();
        let joined = drive(&scene, &mut rover, &mut localizer, &mut results.update_ms)?;
        if let Some(steps) = joined {
            let truth = scene.t_map_world.compose(&rover.truth());
            let estimate = localizer.estimate();
            results.joined += 1;
            results.joined_wrongly += usize::from(scene.is_wrong(&rover, &localizer));
            results.errors_m.push(truth.distance_m(&estimate.t_map_base()));
            results.seconds.push(steps as f64 * STEP_NS as f64 * 1e-9);
        }
    }
    Ok(results)
}

fn open(home: &str) -> Result<Arc<World>> {
    let world = World::open(home, &OpenOptions::default()).context(home.to_owned())?;
    Ok(Arc::new(world))
}

fn scene(home: &str, differs: Differs, count: usize) -> Result<Scene> {
    let mapped = match differs {
        Differs::OtherHome(other) => open(other)?,
        Differs::HalfMapped | Differs::Moved => open(home)?,
    };
    let mut rover = Rover::new(&mapped, 1)?;
    let mut localizer = rover.localizer()?;
    let t_map_world = rover.truth().inverse();
    let mut path = tour::through(mapped.floor_plan(), rover.truth());
    if differs == Differs::HalfMapped {
        path.truncate(path.len() / 2);
    }
    for pose in &path {
        rover.move_to(*pose)?;
        rover.update(&mut localizer);
    }
    localizer.settle();
    let world = match differs {
        Differs::HalfMapped => mapped,
        Differs::Moved => open(&format!("{home}&moved=1"))?,
        Differs::OtherHome(_) => open(home)?,
    };
    let plan = world.floor_plan();
    let is_start = |seed: &u64| {
        let pose = plan.random_pose(*seed);
        let is_unvisited = || path.iter().all(|visited| visited.distance_m(&pose) > UNVISITED_M);
        plan.clearance_m(pose.x_m, pose.y_m) > CLEARANCE_M
            && (differs != Differs::HalfMapped || is_unvisited())
    };
    let seeds = (0..20_000).filter(is_start).take(count).collect();
    let is_other = matches!(differs, Differs::OtherHome(_));
    Ok(Scene { world, memory: localizer.snapshot(), t_map_world, is_other, seeds })
}

/// Rotates twice on the spot. Returns whether the robot found itself.
fn search(rover: &mut Rover, localizer: &mut Localizer) -> Result<bool> {
    for step in 0..STEPS {
        let rotation = if step == 0 { 0.0 } else { STEP_RAD };
        rover.move_to(rover.truth().compose(&Pose2::new(0.0, 0.0, rotation)))?;
        if rover.update(localizer).whereabouts.lost().is_none() {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Drives a tour until both maps are joined. Returns the steps.
fn drive(
    scene: &Scene,
    rover: &mut Rover,
    localizer: &mut Localizer,
    update_ms: &mut Vec<f64>,
) -> Result<Option<usize>> {
    let path = tour::through(scene.world.floor_plan(), rover.truth());
    for (step, pose) in path.into_iter().take(MOST_STEPS).enumerate() {
        rover.move_to(pose)?;
        let start = Instant::now();
        let estimate = rover.update(localizer);
        update_ms.push(start.elapsed().as_secs_f64() * 1e3);
        // Or it was lost once more, and was found in the first map.
        if estimate.joined.is_some() || localizer.map() == 0 {
            return Ok(Some(step + 1));
        }
    }
    Ok(None)
}
