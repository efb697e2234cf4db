//! Perception allocates nothing once it has run: a robot's loop does not wait for memory.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use hal::{
    Base, CameraModel, DriveCommand, ImageView, LaserScan, Lidar, PixelFormat, Pose3, Range,
    ScanGeometry, Twist2, WheelFeedback,
};
use runtime::perception::flow::{DenseFlow, FlowPreset};
use runtime::perception::{CoarseConfig, CoarseDepth};
use runtime::safety::{Orders, Plan, Request, SafetyConfig, SafetyLoop};

const WIDTH: usize = 200;
const HEIGHT: usize = 150;

/// Waves that move by `shift` pixels.
fn picture(shift: f64) -> Vec<u8> {
    let wave = |index: usize| {
        let (x, y) = ((index % WIDTH) as f64 + shift, (index / WIDTH) as f64);
        (x * 0.7).sin() * (y * 0.5).cos() + (x * 0.13 + y * 0.31).sin()
    };
    (0..WIDTH * HEIGHT).map(|index| (128.0 + 50.0 * wave(index)) as u8).collect()
}

fn view(data: &[u8]) -> ImageView<'_> {
    ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, data).unwrap()
}

/// Allocations of a piece of work, counted on the only thread of a pool.
fn allocations(work: impl FnOnce() + Send) -> u64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| allocation_counter::measure(work).count_total)
}

#[test]
fn coarse_depth_allocates_nothing_once_its_keyframes_are_full() {
    let camera = CameraModel::pinhole(WIDTH, HEIGHT, 1.5);
    let config = CoarseConfig { keyframes: 8, ..CoarseConfig::default() };
    let mut engine = CoarseDepth::new(config, camera).unwrap();
    let pictures: Vec<Vec<u8>> = (0..60).map(|step| picture(f64::from(step))).collect();
    let mut with_depth = 0;
    let mut look = |steps: std::ops::Range<usize>| {
        for step in steps {
            let pose = Pose3::translation(0.03 * step as f64, 0.0, 0.0);
            with_depth += u32::from(engine.estimate(view(&pictures[step]), &pose).is_ok());
        }
    };
    look(0..40);
    assert_eq!(allocations(|| look(40..60)), 0);
    assert!(with_depth > 50);
}

#[test]
fn flow_allocates_nothing_after_the_first_call() {
    let (first, second) = (picture(0.0), picture(2.0));
    for preset in [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium] {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        let mut run = || {
            engine.flow(view(&first), view(&second)).unwrap();
        };
        (0..3).for_each(|_| run());
        assert_eq!(allocations(|| (0..5).for_each(|_| run())), 0, "{preset:?}");
    }
}

/// Devices that have something new every turn.
struct Devices {
    now_ns: u64,
    ahead_m: f32,
}

impl hal::ErrorType for Devices {
    type Error = std::convert::Infallible;
}

impl Lidar for Devices {
    fn geometry(&self) -> ScanGeometry {
        ScanGeometry::UTM_30LX
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        self.now_ns += 10_000_000;
        self.ahead_m = if self.ahead_m < 0.2 { 2.0 } else { self.ahead_m - 0.01 };
        scan.time_ns = self.now_ns;
        scan.ranges.clear();
        scan.ranges.resize(1081, Range::Hit(self.ahead_m));
        Ok(true)
    }
}

impl Base for Devices {
    fn drive(&mut self, _command: &DriveCommand) -> Result<(), Self::Error> {
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Self::Error> {
        self.now_ns += 10_000_000;
        Ok(Some(WheelFeedback { time_ns: self.now_ns, ..WheelFeedback::default() }))
    }
}

#[test]
fn the_safety_loop_allocates_nothing_after_its_first_scan_whatever_state_it_is_in() {
    let devices = || Devices { now_ns: 0, ahead_m: 2.0 };
    let config = SafetyConfig { period_s: 0.01, ..SafetyConfig::default() };
    let mut control = SafetyLoop::new(config, devices(), devices());
    let mut names = std::collections::BTreeSet::new();
    let mut counted = 0;
    for turn in 1..3000_u64 {
        let now_ns = turn * 10_000_000;
        let plan =
            Some(Plan { twist: Twist2 { linear_mps: 0.3, angular_radps: 0.0 }, time_ns: now_ns });
        let request = match turn % 1000 {
            1 => Some(Request::Arm),
            900 => Some(Request::ClearFault),
            _ => None,
        };
        let emergency_stop = turn % 1000 == 800;
        let orders = Orders { plan, request, emergency_stop, ..Orders::default() };
        let turn_of = allocations(|| _ = control.step(now_ns, &orders));
        counted += if turn > 1 { turn_of } else { 0 };
        names.insert(control.plane().state().name());
    }
    assert_eq!(counted, 0);
    let all = ["backing off", "clear", "disarmed", "escaping", "fault", "tripped"];
    assert_eq!(names.into_iter().collect::<Vec<_>>(), all);
}
