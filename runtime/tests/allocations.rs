//! Perception and the safety loop allocate nothing after their first steps, so that they never wait for memory.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use hal::{
    Base, CameraModel, CameraMount, DriveCommand, ImageView, LaserScan, Lidar, PixelFormat, Pose3,
    Range, ScanGeometry, Twist2, WheelFeedback,
};
use runtime::perception::flow::{DenseFlow, FlowPreset};
use runtime::perception::{CoarseConfig, CoarseDepth};
use runtime::safety::{Orders, Plan, Request, SafetyConfig, SafetyLoop};

const WIDTH: usize = 200;
const HEIGHT: usize = 150;

/// Waves that move by `shift` pixels.
fn image(shift: f64) -> Vec<u8> {
    let pixels = (0..WIDTH * HEIGHT).map(|index| {
        let x = (index % WIDTH) as f64 + shift;
        let y = (index / WIDTH) as f64;
        let wave = (x * 0.7).sin() * (y * 0.5).cos() + (x * 0.13 + y * 0.31).sin();
        (128.0 + 50.0 * wave) as u8
    });
    pixels.collect()
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
    let mut engine = CoarseDepth::new(config, camera).unwrap().with_floor(true);
    let images: Vec<Vec<u8>> = (0..60).map(|step| image(f64::from(step))).collect();
    let mut with_depth = estimate(&mut engine, &images, 0..40);
    assert_eq!(allocations(|| with_depth += estimate(&mut engine, &images, 40..60)), 0);
    assert!(with_depth > 50);
}

/// The number of images with depth.
fn estimate(engine: &mut CoarseDepth, images: &[Vec<u8>], steps: std::ops::Range<usize>) -> u32 {
    let mut with_depth = 0;
    for step in steps {
        let t_odom_base = Pose3::translation(0.0, -0.03 * step as f64, 0.0);
        let t_odom_camera = t_odom_base * CameraMount::default().t_base_camera();
        with_depth += u32::from(engine.estimate(view(&images[step]), &t_odom_camera).is_ok());
    }
    with_depth
}

#[test]
fn flow_allocates_nothing_after_the_first_call() {
    let first = image(0.0);
    let second = image(2.0);
    for preset in [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium] {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        (0..3).for_each(|_| flow(&mut engine, &first, &second));
        let more = allocations(|| (0..5).for_each(|_| flow(&mut engine, &first, &second)));
        assert_eq!(more, 0, "{preset:?}");
    }
}

fn flow(engine: &mut DenseFlow, first: &[u8], second: &[u8]) {
    engine.flow(view(first), view(second)).unwrap();
}

/// A scanner and a base with a new reading at every poll.
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
fn the_safety_loop_allocates_nothing_after_its_first_scan_in_any_state() {
    let base = Devices { now_ns: 0, ahead_m: 2.0 };
    let lidar = Devices { now_ns: 0, ahead_m: 2.0 };
    let config = SafetyConfig { period_s: 0.01, blind_back_off_m: 0.05, ..SafetyConfig::default() };
    let mut control = SafetyLoop::new(config, base, lidar);
    let mut names = std::collections::BTreeSet::new();
    let mut counted = 0;
    for step in 1..3000_u64 {
        let now_ns = step * 10_000_000;
        let plan =
            Some(Plan { twist: Twist2 { linear_mps: 0.3, angular_radps: 0.0 }, time_ns: now_ns });
        let request = match step % 1000 {
            1 => Some(Request::Arm),
            900 => Some(Request::ClearFault),
            _ => None,
        };
        let emergency_stop = step % 1000 == 800;
        let orders = Orders { plan, request, emergency_stop, ..Orders::default() };
        let of_step = allocations(|| _ = control.step(now_ns, &orders));
        counted += if step > 1 { of_step } else { 0 };
        names.insert(control.plane().state().name());
    }
    assert_eq!(counted, 0);
    let all = ["backing off", "clear", "disarmed", "escaping", "fault", "tripped"];
    assert_eq!(names.into_iter().collect::<Vec<_>>(), all);
}
