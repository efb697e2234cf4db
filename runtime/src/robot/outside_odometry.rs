//! Odometry from another program in place of the wheels'.
//!
//! The other program's poses are late, may be few, and are in a frame of its own. Each one that is accepted corrects the wheel
//! odometry that localization gets; between two of them, and while none come, the wheels carry the pose on. Scans correct the
//! result as they correct wheels. The safety plane uses the wheels as they are.

use hal::Pose2;
use serde::{Deserialize, Serialize};

use crate::event::{Event, RefusedInput};
use crate::outside_pose::{OutsideInput, OutsidePose};
use crate::tick::TickInput;

/// An older pose is not used: wheels drift little in that time, and what sends so late is not well.
const MAX_AGE_NS: u64 = 500_000_000;
/// Clocks of one computer agree. A pose from a time further ahead has a stamp of another clock.
const MAX_AHEAD_NS: u64 = 50_000_000;
/// Without an accepted pose for this long the other program counts as silent.
const SILENT_NS: u64 = 1_000_000_000;
/// No robot of this kind drives or rotates faster. What moves faster has jumped: the other program has moved its frame, as it
/// does when it closes a loop or starts again.
const MAX_SPEED_MPS: f64 = 2.0;
const MAX_YAW_RATE_RADPS: f64 = 4.0;
/// Noise of two poses that are near in time, metres and radians.
const NOISE_M: f64 = 0.05;
const NOISE_RAD: f64 = 0.05;

/// Wheel odometry as corrected by the other program's poses.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct OutsideOdometry {
    /// Pose of the wheels' odometry in the corrected one; `None` before the first accepted pose.
    t_odom_wheels: Option<Pose2>,
    /// Pose of the other program's frame in the corrected odometry.
    t_odom_outside: Pose2,
    last: Option<OutsidePose>,
    is_silent: bool,
}

impl OutsideOdometry {
    /// Takes the tick's pose, if there is one, and returns the input with corrected wheel odometry. The wheel poses must be finite.
    pub(super) fn apply<'a>(
        &mut self,
        input: &TickInput<'a>,
        events: &mut Vec<Event>,
    ) -> TickInput<'a> {
        if let Some(outside) = &input.outside
            && let Err(why) = self.take(outside, input.time_ns)
        {
            events.push(Event::InputRefused { why });
        }
        self.note_silence(input.time_ns, events);
        let mut input = *input;
        if let Some(t_odom_wheels) = self.t_odom_wheels.filter(Pose2::is_finite) {
            input.wheel.odom = t_odom_wheels.compose(&input.wheel.odom);
            input.scan_odom = t_odom_wheels.compose(&input.scan_odom);
        }
        input
    }

    /// Corrects the odometry by a pose, unless it must be refused.
    fn take(&mut self, input: &OutsideInput, now_ns: u64) -> Result<(), RefusedInput> {
        let OutsideInput { outside, wheel_odom } = input;
        if !(outside.pose.is_finite() && wheel_odom.is_finite()) {
            return Err(RefusedInput::OutsidePoseNotFinite);
        }
        let is_old = outside.time_ns.saturating_add(MAX_AGE_NS) < now_ns;
        let is_ahead = outside.time_ns > now_ns.saturating_add(MAX_AHEAD_NS);
        let is_repeated = self.last.is_some_and(|last| outside.time_ns <= last.time_ns);
        if is_old || is_ahead || is_repeated {
            return Err(RefusedInput::OutsidePoseTime);
        }
        let by_wheels = self.t_odom_wheels.unwrap_or_default().compose(wheel_odom);
        let has_jumped = self.last.is_some_and(|last| is_jump(&last, outside));
        if has_jumped || self.last.is_none() {
            // The odometry goes on where the wheels say that the robot is.
            self.t_odom_outside = by_wheels.compose(&outside.pose.inverse());
        }
        let here = self.t_odom_outside.compose(&outside.pose);
        self.t_odom_wheels = Some(here.compose(&wheel_odom.inverse()));
        self.last = Some(*outside);
        if has_jumped { Err(RefusedInput::OutsidePoseJump) } else { Ok(()) }
    }

    fn note_silence(&mut self, now_ns: u64, events: &mut Vec<Event>) {
        let Some(last) = &self.last else { return };
        let was_silent =
            std::mem::replace(&mut self.is_silent, now_ns.saturating_sub(last.time_ns) > SILENT_NS);
        if self.is_silent && !was_silent {
            events.push(Event::OutsidePosesSilent);
        }
    }
}

fn is_jump(last: &OutsidePose, next: &OutsidePose) -> bool {
    let seconds = (next.time_ns - last.time_ns) as f64 * 1e-9;
    let moved = last.pose.inverse().compose(&next.pose);
    moved.x_m.hypot(moved.y_m) > NOISE_M + MAX_SPEED_MPS * seconds
        || moved.yaw_rad.abs() > NOISE_RAD + MAX_YAW_RATE_RADPS * seconds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::RecordedTick;

    const TICK_NS: u64 = 100_000_000;

    /// Wheels that claim `WHEEL_FACTOR` times the true distance, and an outside source whose frame is elsewhere.
    struct Drive {
        odometry: OutsideOdometry,
        events: Vec<Event>,
        tick: u64,
        true_m: f64,
        t_outside_start: Pose2,
    }

    const WHEEL_FACTOR: f64 = 1.5;

    impl Drive {
        fn new() -> Self {
            Self {
                odometry: OutsideOdometry::default(),
                events: Vec::new(),
                tick: 100,
                true_m: 0.0,
                t_outside_start: Pose2::new(7.0, -3.0, 2.0),
            }
        }

        /// Drives 3 cm straight on; returns the odometry that localization gets.
        fn step(&mut self, outside: Option<fn(&mut OutsidePose)>) -> Pose2 {
            self.tick += 1;
            self.true_m += 0.03;
            let mut tick = RecordedTick::new(self.tick, self.tick * TICK_NS);
            tick.wheel.odom = Pose2::new(WHEEL_FACTOR * self.true_m, 0.0, 0.0);
            tick.outside = outside.map(|change| {
                let pose = self.t_outside_start.compose(&Pose2::new(self.true_m, 0.0, 0.0));
                let mut outside = OutsidePose { time_ns: tick.time_ns, pose };
                change(&mut outside);
                OutsideInput { outside, wheel_odom: tick.wheel.odom }
            });
            let input = tick.input().unwrap();
            self.odometry.apply(&input, &mut self.events).wheel.odom
        }

        fn refusals(&self) -> Vec<RefusedInput> {
            let refused = self.events.iter().filter_map(|event| match event {
                Event::InputRefused { why } => Some(*why),
                _ => None,
            });
            refused.collect()
        }
    }

    fn as_it_is(_: &mut OutsidePose) {}

    #[test]
    fn without_an_outside_pose_every_bit_of_the_odometry_is_kept() {
        let mut tick = RecordedTick::new(0, 0);
        tick.wheel.odom = Pose2 { x_m: -0.0, y_m: 1.0 / 3.0, yaw_rad: 4.0 };
        let mut odometry = OutsideOdometry::default();
        let input = tick.input().unwrap();
        assert_eq!(odometry.apply(&input, &mut Vec::new()).wheel.odom, tick.wheel.odom);
    }

    #[test]
    fn the_distance_is_that_of_the_outside_poses_and_the_frame_that_of_the_wheels() {
        let mut drive = Drive::new();
        let first = drive.step(Some(as_it_is));
        let mut last = first;
        for _ in 0..100 {
            last = drive.step(Some(as_it_is));
        }
        let moved = first.inverse().compose(&last);
        assert!((moved.x_m - 3.0).abs() < 1e-9 && moved.y_m.abs() < 1e-9, "{moved:?}");
        assert!(first.distance_m(&Pose2::new(0.045, 0.0, 0.0)) < 1e-12, "{first:?}");
        assert!(drive.events.is_empty(), "{:?}", drive.events);
    }

    #[test]
    fn while_no_pose_comes_the_wheels_carry_on_and_the_silence_is_reported_once() {
        let mut drive = Drive::new();
        let first = drive.step(Some(as_it_is));
        let mut last = first;
        for _ in 0..20 {
            last = drive.step(None);
        }
        let moved = first.inverse().compose(&last);
        assert!((moved.x_m - 20.0 * 0.03 * WHEEL_FACTOR).abs() < 1e-9, "{moved:?}");
        assert_eq!(drive.events, [Event::OutsidePosesSilent]);
        // What the wheels got wrong meanwhile is put right by the next pose.
        let back = drive.step(Some(as_it_is));
        assert!((first.inverse().compose(&back).x_m - 21.0 * 0.03).abs() < 1e-9);
    }

    #[test]
    fn a_pose_that_is_newer_than_the_frame_of_its_tick_is_used() {
        let mut tick = RecordedTick::new(50, 50 * TICK_NS);
        // A camera needs some time, and a tick has the wheels at the time of its frame.
        tick.wheel.time_ns -= 2 * MAX_AHEAD_NS;
        let outside = OutsidePose { time_ns: tick.time_ns, pose: Pose2::IDENTITY };
        tick.outside = Some(OutsideInput { outside, wheel_odom: Pose2::IDENTITY });
        let mut odometry = OutsideOdometry::default();
        let mut events = Vec::new();
        odometry.apply(&tick.input().unwrap(), &mut events);
        assert!(events.is_empty() && odometry.last == Some(outside), "{events:?}");
    }

    #[test]
    fn a_jump_is_reported_and_is_no_motion() {
        let mut drive = Drive::new();
        let first = drive.step(Some(as_it_is));
        drive.t_outside_start = Pose2::new(-40.0, 9.0, 0.3);
        let after = drive.step(Some(as_it_is));
        assert!((first.inverse().compose(&after).x_m - 0.03 * WHEEL_FACTOR).abs() < 1e-9);
        assert_eq!(drive.refusals(), [RefusedInput::OutsidePoseJump]);
        // From then on its poses count again.
        let next = drive.step(Some(as_it_is));
        assert!((after.inverse().compose(&next).x_m - 0.03).abs() < 1e-9);
        assert_eq!(drive.refusals().len(), 1);
    }

    #[test]
    fn nan_and_poses_of_another_time_are_refused_and_change_nothing() {
        let mut drive = Drive::new();
        let first = drive.step(Some(as_it_is));
        let broken: [fn(&mut OutsidePose); 5] = [
            |outside| outside.pose.yaw_rad = f64::NAN,
            |outside| outside.pose.x_m = f64::INFINITY,
            |outside| outside.time_ns -= MAX_AGE_NS + 1,
            |outside| outside.time_ns += MAX_AHEAD_NS + 1,
            |outside| outside.time_ns = u64::MAX,
        ];
        for (at, change) in broken.into_iter().enumerate() {
            let pose = drive.step(Some(change));
            let by_wheels = (at + 1) as f64 * 0.03 * WHEEL_FACTOR;
            assert!((first.inverse().compose(&pose).x_m - by_wheels).abs() < 1e-9);
        }
        use RefusedInput::{OutsidePoseNotFinite as NotFinite, OutsidePoseTime as Time};
        assert_eq!(drive.refusals(), [NotFinite, NotFinite, Time, Time, Time]);
        // The same pose twice is one pose.
        drive.step(Some(as_it_is));
        drive.step(Some(|outside| outside.time_ns -= TICK_NS));
        assert_eq!(drive.refusals().last(), Some(&Time));
    }
}
