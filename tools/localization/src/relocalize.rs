//! Trials of finding a lost robot, in simulated homes: `localization --relocalize`.
//!
//! In each home a robot first maps all reachable floor. Then it is put at random places and restarted in that
//! map; it rotates on the spot as the robot does. A place that it accepts is compared with the truth.

use std::sync::Arc;

use anyhow::{Context, Result};
use hal::{Clock, LaserScan, Lidar, Pose2, wrap_angle};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::localization::{LocalizationConfig, Localizer, LostReason};
use simulator::robot::{SimClock, SimLidar};
use simulator::{OpenOptions, RobotOptions, SimulatedRobot, World};

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
/// Time and rotation between scans: a robot that rotates at 20 degrees per second.
const STEP_NS: u64 = 100_000_000;
const STEP_RAD: f64 = 0.035;
/// Noise of the wheels, as a share, and drift per metre.
const WHEEL_NOISE: f64 = 0.02;
const WHEEL_DRIFT_RAD_PER_M: f64 = 0.03;
/// Steps of a trial: two rotations.
const STEPS: usize = 360;
/// A trial's start keeps this distance from furniture, metres.
const CLEARANCE_M: f64 = 0.25;

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

pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1) as f64;
    sorted.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
}

/// A robot that is put from pose to pose, with wheels that report noisy motions.
struct Ghost {
    robot: SimulatedRobot,
    lidar: SimLidar,
    clock: SimClock,
    scan: LaserScan,
    truth: Pose2,
    wheel: Pose2,
    rng: Pcg64Mcg,
}

impl Ghost {
    fn new(world: &Arc<World>, seed: u64) -> Result<Self> {
        let options = RobotOptions { seed, ..RobotOptions::default() };
        let robot = SimulatedRobot::new(world.clone(), options)?;
        let devices = robot.devices();
        let scan = LaserScan::empty(devices.lidar.geometry());
        Ok(Self {
            truth: devices.truth.pose(),
            robot,
            lidar: devices.lidar,
            clock: devices.clock,
            scan,
            wheel: Pose2::IDENTITY,
            rng: Pcg64Mcg::seed_from_u64(seed),
        })
    }

    /// Is at `truth` for the next scan; the wheels report about the motion to there.
    fn drive_to(&mut self, truth: Pose2) {
        let motion = self.truth.inverse().compose(&truth);
        let [distance, yaw] = [0, 1].map(|_| 1.0 + WHEEL_NOISE * self.rng.random_range(-1.7..1.7));
        let drift_rad = WHEEL_DRIFT_RAD_PER_M * motion.x_m;
        let reported = Pose2::new(
            distance * motion.x_m,
            distance * motion.y_m,
            yaw * motion.yaw_rad + drift_rad,
        );
        self.wheel = self.wheel.compose(&reported);
        self.truth = truth;
    }

    fn update(&mut self, localizer: &mut Localizer) -> Result<runtime::localization::Estimate> {
        self.robot.carry_to(self.truth);
        let now_ns = self.clock.now_ns() + STEP_NS;
        self.clock.sleep_until_ns(now_ns);
        self.lidar.poll_scan(&mut self.scan)?;
        Ok(localizer.update(&self.wheel, now_ns, Some((&self.scan, &self.wheel))))
    }
}

fn localizer(ghost: &Ghost) -> Result<Localizer> {
    let options = RobotOptions::default();
    let mount = options.t_base_laser.translation;
    let geometry = ghost.lidar.geometry();
    let t_base_laser = Pose2::new(mount.x, mount.y, 0.0);
    Ok(Localizer::new(&LocalizationConfig::default(), geometry, t_base_laser)?)
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
    let mut ghost = Ghost::new(&world, 1)?;
    let mut localizer = localizer(&ghost)?;
    let t_map_world = ghost.truth.inverse();
    let mut lost = 0;
    for pose in tour::through(world.floor_plan(), ghost.truth) {
        ghost.drive_to(pose);
        let estimate = ghost.update(&mut localizer)?;
        if estimate.whereabouts.lost().is_some() {
            lost += 1;
            localizer.continue_by_wheels();
        }
    }
    localizer.settle();
    let end = t_map_world.compose(&ghost.truth);
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
        let mut ghost = Ghost::new(&home.world, seed)?;
        let mut localizer = localizer(&ghost)?;
        localizer.restore(&mapped.memory)?;
        localizer.lose(LostReason::Loaded);
        ghost.truth = plan.random_pose(seed);
        for step in 0..STEPS {
            let estimate = ghost.update(&mut localizer)?;
            if estimate.whereabouts.lost().is_none() {
                let truth = home.t_map_world.compose(&ghost.truth);
                let error = truth.inverse().compose(&estimate.t_map_base());
                let error_m = error.x_m.hypot(error.y_m);
                let is_off = error_m > WRONG_M || wrap_angle(error.yaw_rad).abs() > WRONG_RAD;
                results.found += 1;
                results.within_3_scans += usize::from(localizer.scans_searched() <= 3);
                results.wrong += usize::from(is_off || is_other);
                results.errors_m.push(error_m);
                results.seconds.push((step + 1) as f64 * STEP_NS as f64 * 1e-9);
                break;
            }
            ghost.drive_to(ghost.truth.compose(&Pose2::new(0.0, 0.0, STEP_RAD)));
        }
    }
    Ok(results)
}
