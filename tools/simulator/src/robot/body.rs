//! The state that the devices share, and what moves it.

use std::sync::Arc;

use hal::{DepthMap, DriveCommand, Frame, LaserScan, PixelFormat, Pose2, Pose3, Twist2, WheelFeedback};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::options::RobotOptions;
use crate::error::SceneError;
use crate::floor::{Disc, FloorPlan};
use crate::laser;
use crate::odometry::Odometer;
use crate::people::{Person, Walker};
use crate::world::World;

/// Motion is computed in steps that end at multiples of this, however long the caller sleeps.
const STEP_NS: u64 = 10_000_000;

/// Pictures that make up one with motion blur.
const BLUR_PICTURES: usize = 8;

/// People walk at this speed, m/s: at home, nobody hurries.
const WALKING_MPS: f64 = 0.8;

/// Somebody's body at the height of the robot, metres.
const PERSON_RADIUS_M: f64 = 0.2;

#[derive(Debug)]
pub(super) struct Body {
    pub options: RobotOptions,
    pub plan: Arc<FloorPlan>,
    pub now_ns: u64,
    /// True pose of the base in the world.
    pub pose: Pose2,
    pub contacts: u64,
    pub path_m: f64,
    /// Depth of the newest frame, its time and its pose.
    pub depth: DepthMap,
    pub framed: Option<(u64, Pose2)>,
    world: Arc<World>,
    odometer: Odometer,
    wanted: Twist2,
    last_counter: Option<u32>,
    stops_at_ns: u64,
    measured: Twist2,
    /// Something was met during the newest step.
    touching: bool,
    /// Something was met since the last feedback.
    touched: bool,
    reported_ns: Option<u64>,
    scanned_ns: Option<u64>,
    sequence: u32,
    walkers: Vec<Walker>,
    laser_rng: Pcg64Mcg,
    camera_rng: Pcg64Mcg,
}

impl Body {
    pub fn new(world: Arc<World>, options: RobotOptions) -> Result<Self, SceneError> {
        options.check()?;
        let pose = options.start.unwrap_or_else(|| world.floor_plan().start_pose(options.seed));
        let plan = plan_around(world.floor_plan(), &pose)?;
        let seed = |stream: u64| options.seed.wrapping_mul(8).wrapping_add(stream);
        let walkers = (0..options.nuisances.people as u64).filter_map(|i| {
            let seed = seed(3).wrapping_add(i << 32);
            Walker::new(plan.stroll(seed), WALKING_MPS, seed)
        });
        Ok(Self {
            walkers: walkers.collect(),
            odometer: Odometer::new(options.odometry, seed(0)),
            laser_rng: Pcg64Mcg::seed_from_u64(seed(1)),
            camera_rng: Pcg64Mcg::seed_from_u64(seed(2)),
            plan,
            now_ns: 0,
            pose,
            contacts: 0,
            path_m: 0.0,
            depth: DepthMap::none(options.camera.width, options.camera.height),
            framed: None,
            world,
            wanted: Twist2::ZERO,
            last_counter: None,
            stops_at_ns: 0,
            measured: Twist2::ZERO,
            touching: false,
            touched: false,
            reported_ns: None,
            scanned_ns: None,
            sequence: 0,
            options,
        })
    }

    /// Takes a command. One with the counter of the last one is a repeated frame, not a live sender.
    pub fn command(&mut self, command: &DriveCommand) {
        if self.last_counter.replace(command.counter) != Some(command.counter) {
            self.wanted = command.twist;
            self.stops_at_ns = self.now_ns.saturating_add(self.options.watchdog_ns);
        }
    }

    pub fn stop(&mut self) {
        self.wanted = Twist2::ZERO;
        self.measured = Twist2::ZERO;
        self.touching = false;
    }

    /// Lets time pass. The twist is held until the watchdog stops the base.
    pub fn advance_to(&mut self, deadline_ns: u64) {
        while self.now_ns < deadline_ns {
            if self.now_ns >= self.stops_at_ns {
                self.stop();
                self.now_ns = deadline_ns;
                return;
            }
            let tick_ns = (self.now_ns / STEP_NS + 1) * STEP_NS;
            let until_ns = deadline_ns.min(tick_ns).min(self.stops_at_ns);
            self.step((until_ns - self.now_ns) as f64 * 1e-9);
            self.now_ns = until_ns;
        }
    }

    fn step(&mut self, seconds: f64) {
        if self.wanted == Twist2::ZERO {
            self.stop();
            return;
        }
        let discs: Vec<Disc> = self
            .people()
            .iter()
            .map(|person| Disc { center_m: person.position_m, radius_m: PERSON_RADIUS_M })
            .collect();
        let body = crate::floor::Body { sliding: self.options.sliding };
        let moved = self.plan.drive(&self.pose, &self.wanted, seconds, &body, &discs);
        // A robot that goes on pushing makes one contact, not a hundred a second.
        self.contacts += u64::from(moved.contact && !self.touching);
        self.touching = moved.contact;
        self.touched |= moved.contact;
        self.path_m += self.pose.distance_m(&moved.pose);
        // The wheels stall when the base does, and turn as far as it really moves.
        self.odometer.advance(&self.pose.inverse().compose(&moved.pose));
        self.measured = if moved.contact { Twist2::ZERO } else { self.wanted };
        self.pose = moved.pose;
    }

    pub fn feedback(&mut self) -> Option<WheelFeedback> {
        if self.reported_ns.replace(self.now_ns) == Some(self.now_ns) {
            return None;
        }
        let contact = std::mem::take(&mut self.touched);
        Some(WheelFeedback { time_ns: self.now_ns, odom: self.odometer.pose(), twist: self.measured, contact })
    }

    /// Takes a scan now, when a period has passed since the last one.
    pub fn scan(&mut self, scan: &mut LaserScan) -> bool {
        let period_ns = self.options.laser.geometry.period_ns.max(1);
        if self.scanned_ns.is_some_and(|last| self.now_ns < last.saturating_add(period_ns)) {
            return false;
        }
        self.scanned_ns = Some(self.now_ns);
        let pose = self.pose.to_pose3() * Pose3::translation(0.0, 0.0, self.options.laser_height_m);
        let (people, world) = (self.people(), Arc::clone(&self.world));
        let (model, rng) = (&self.options.laser, &mut self.laser_rng);
        laser::scan(world.renderer(), &pose, &people, model, rng, self.now_ns, scan);
        true
    }

    /// Takes a picture now, unless one of this moment was handed out.
    pub fn photograph(&mut self, frame: &mut Frame) -> bool {
        if self.framed.is_some_and(|(time_ns, _)| time_ns == self.now_ns) {
            return false;
        }
        let (camera, nuisances) = (self.options.camera, &self.options.nuisances);
        let (people, light) = (self.people(), nuisances.lighting(self.now_ns));
        let view = |pose: &Pose2| pose.to_pose3() * self.options.t_base_camera;
        let renderer = self.world.renderer();
        if nuisances.shutter_s > 0.0 && self.measured != Twist2::ZERO {
            let half = self.measured.integrate(nuisances.shutter_s / 2.0);
            let (opens, closes) = (self.pose.compose(&half.inverse()), self.pose.compose(&half));
            let views = [&view(&opens), &view(&closes)];
            renderer.render_blurred(&camera, views, BLUR_PICTURES, &people, &light, &mut frame.data, &mut self.depth);
        } else {
            let from = view(&self.pose);
            renderer.render(&camera, &from, &people, &light, &mut frame.data, &mut self.depth);
        }
        nuisances.add_sensor_noise(&mut self.camera_rng, &mut frame.data);
        (frame.time_ns, frame.sequence) = (self.now_ns, self.sequence);
        (frame.width, frame.height, frame.format) = (camera.width, camera.height, PixelFormat::Rgb8);
        self.sequence = self.sequence.wrapping_add(1);
        self.framed = Some((self.now_ns, self.pose));
        true
    }

    pub fn t_odom_base(&self) -> Pose2 {
        self.odometer.pose()
    }

    fn people(&self) -> Vec<Person> {
        self.walkers.iter().map(|walker| walker.at(self.now_ns)).collect()
    }
}

/// The plan with the free space around the start as the reachable one.
fn plan_around(plan: &Arc<FloorPlan>, start: &Pose2) -> Result<Arc<FloorPlan>, SceneError> {
    let (x_m, y_m) = (start.x_m, start.y_m);
    if plan.is_reachable(x_m, y_m) && plan.fits(x_m, y_m, &[]) {
        return Ok(Arc::clone(plan));
    }
    let other = plan.fits(x_m, y_m, &[]).then(|| plan.around(x_m, y_m)).flatten();
    other.map(Arc::new).ok_or_else(|| {
        let [nearest_x_m, nearest_y_m] = plan.nearest_free(x_m, y_m);
        SceneError::StartBlocked { x_m, y_m, nearest_x_m, nearest_y_m }
    })
}
