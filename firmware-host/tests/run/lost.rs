//! Robots that are carried, pushed, held and restarted elsewhere, while the whole program drives them through their devices.

use std::f64::consts::TAU;

use drivers::can::Protocol;
use firmware_host::recorded::Recorded;
use hal::{Pose2, wrap_angle};
use hil::world::{Handled, Home};
use runtime::event::Event;
use runtime::localization::{LostReason, WheelError};
use runtime::recording::RecordedTick;
use rustix::process::Signal;

use super::scene::{Scene, in_folder, pause, replayed, start};

/// A robot that has driven a little, and where its map begins in the world.
struct Drive {
    scene: Scene,
    start: Pose2,
}

impl Drive {
    fn begin(args: &[&str]) -> Self {
        let scene = Scene::with(Protocol::Odrive, "", args);
        // Nothing moves before the program has opened its devices.
        let start = scene.world.home().pose();
        scene.drives_first();
        scene.drives("driving on");
        Self { scene, start }
    }

    fn home(&self) -> &Home {
        self.scene.world.home()
    }

    fn is_lost(&self) -> bool {
        self.scene.status().is_some_and(|status| status.exploration.lost.is_some())
    }

    /// Waits as a person who arms the robot whenever it needs one.
    fn wait_beside_it(&self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        self.scene.wait(what, |scene| {
            if scene.status().is_some_and(|status| status.safety.needs_person) {
                scene.signal(Signal::USR1);
                pause(300);
            }
            done(self)
        });
    }

    fn is_lost_and_found(&self) {
        self.wait_beside_it("a robot that is lost", Self::is_lost);
        self.wait_beside_it("a robot that is found", |drive| !drive.is_lost());
    }

    fn drives_on(&self) {
        let (_, before_m) = self.home().score();
        self.wait_beside_it("driving on", |drive| drive.home().score().1 > before_m + 0.2);
    }

    /// Presses the emergency stop, ends the program, and compares the last pose with the truth. Returns the ticks of the run.
    fn ends_at_the_true_place(&mut self, run: &str) -> Vec<RecordedTick> {
        self.scene.signal(Signal::USR2);
        pause(1500);
        let truth = self.home().pose();
        self.scene.signal(Signal::TERM);
        assert!(self.scene.robot.wait().unwrap().success());
        let ticks = ticks(&self.scene, run);
        let pose = ticks.last().unwrap().decision.as_ref().unwrap().t_map_base();
        let expected = self.start.inverse().compose(&truth);
        let error = expected.inverse().compose(&pose);
        let degrees = wrap_angle(error.yaw_rad).abs().to_degrees();
        assert!(error.x_m.hypot(error.y_m) < 0.15 && degrees < 5.0, "{error:?}");
        let (same, text) = replayed(&self.scene.path(run), &[]);
        assert!(same && text.contains("mismatches=0"), "{text}");
        ticks
    }
}

fn ticks(scene: &Scene, run: &str) -> Vec<RecordedTick> {
    Recorded::open(&scene.path(run)).unwrap().ticks().map(Result::unwrap).collect()
}

/// What was reported, with the number of the tick.
fn events(ticks: &[RecordedTick]) -> Vec<(u64, Event)> {
    let decisions = ticks.iter().filter_map(|tick| tick.decision.as_ref());
    let events = decisions
        .flat_map(|decision| decision.events.iter().map(|event| (decision.tick, event.clone())));
    events.collect()
}

/// When the robot was lost for this reason, and when it was found after that.
fn assert_lost_then_found(ticks: &[RecordedTick], is_reason: impl Fn(LostReason) -> bool) {
    let events = events(ticks);
    let lost =
        events.iter().find(|(_, event)| matches!(event, Event::Lost { why } if is_reason(*why)));
    let Some((lost, _)) = lost else { panic!("it was not lost") };
    let is_found =
        |(tick, event): &(u64, Event)| tick > lost && matches!(event, Event::Found { .. });
    assert!(events.iter().any(is_found), "lost at tick {lost} and not found");
}

fn wheel_errors(ticks: &[RecordedTick]) -> Vec<WheelError> {
    let events = events(ticks).into_iter();
    let errors = events.filter_map(|(_, event)| match event {
        Event::WheelsContradicted { how } => Some(how),
        _ => None,
    });
    errors.collect()
}

/// Things are this much further away than the robot's body where a robot is put, so that it can drive on in every direction.
const ROOM_M: f64 = 0.2;

/// A place about 2 m from here with open floor between, so that the robot has seen it, with room around it, and another heading.
fn two_metres_from(home: &Home, here: &Pose2) -> Pose2 {
    let plan = home.world().floor_plan();
    let place = |bearing_rad: f64, metres: f64| {
        let (sin, cos) = bearing_rad.sin_cos();
        Pose2::new(here.x_m + metres * cos, here.y_m + metres * sin, here.yaw_rad + 2.0)
    };
    let fits = |at: &Pose2| plan.fits(at.x_m, at.y_m, &[]);
    let has_room = |at: &Pose2| {
        let around = (0..8).map(|eighth| Pose2::new(0.0, 0.0, f64::from(eighth) * TAU / 8.0));
        around
            .map(|ahead| at.compose(&ahead).compose(&Pose2::new(ROOM_M, 0.0, 0.0)))
            .all(|at| fits(&at))
    };
    let bearings = (0..72).map(|step| f64::from(step) * TAU / 72.0);
    let open_m = |bearing_rad: f64| {
        let steps = (1..=20).map(|step| 0.1 * f64::from(step));
        steps
            .take_while(|metres| fits(&place(bearing_rad, *metres)))
            .filter(|metres| has_room(&place(bearing_rad, *metres)))
            .last()
            .unwrap_or(0.0)
    };
    let best = bearings.max_by(|a, b| open_m(*a).total_cmp(&open_m(*b))).unwrap();
    place(best, open_m(best))
}

#[test]
fn a_robot_that_is_carried_two_metres_is_lost_finds_itself_at_the_true_place_and_drives_on() {
    let mut drive = Drive::begin(&[]);
    let here = drive.home().pose();
    let there = two_metres_from(drive.home(), &here);
    assert!(here.distance_m(&there) > 1.5, "{here:?} {there:?}");
    drive.home().handle(&Handled::Carried(there)).unwrap();
    drive.is_lost_and_found();
    drive.drives_on();
    let ticks = drive.ends_at_the_true_place("run");
    assert_lost_then_found(&ticks, |why| why != LostReason::Loaded);
}

#[test]
fn a_robot_that_is_pushed_by_20_cm_reports_it_and_goes_on_with_the_right_pose() {
    let mut drive = Drive::begin(&[]);
    let sideways = [0.2, -0.2].map(|left_m| Handled::Pushed { forward_m: 0.0, left_m });
    drive.wait_beside_it("room for a push", |drive| {
        sideways.iter().any(|push| drive.home().handle(push).is_ok())
    });
    pause(1000);
    drive.drives_on();
    let ticks = drive.ends_at_the_true_place("run");
    assert!(wheel_errors(&ticks).contains(&WheelError::Pushed), "{:?}", wheel_errors(&ticks));
    let is_lost = |(_, event): &(u64, Event)| matches!(event, Event::Lost { .. });
    assert!(!events(&ticks).iter().any(is_lost));
}

/// The safety plane stops wheels that spin for this long; a person arms the robot then.
#[test]
fn wheels_that_spin_for_three_seconds_are_reported_and_the_pose_stays_right() {
    let mut drive = Drive::begin(&[]);
    let spins = |drive: &Drive| {
        let wheels = drive.scene.world.wheels();
        wheels.iter().any(|node| node.wheel().velocity_radps().abs() > 1.0)
    };
    drive.wait_beside_it("wheels that rotate", spins);
    drive.home().handle(&Handled::WithoutGrip { seconds: 3.0 }).unwrap();
    let stood = drive.home().pose();
    drive.wait_beside_it("grip", |drive| !drive.home().is_without_grip());
    assert!(drive.home().pose().distance_m(&stood) < 0.05, "wheels without grip moved it");
    drive.drives_on();
    let ticks = drive.ends_at_the_true_place("run");
    assert!(wheel_errors(&ticks).contains(&WheelError::Spin), "{:?}", wheel_errors(&ticks));
    let is_lost = |(_, event): &(u64, Event)| matches!(event, Event::Lost { .. });
    assert!(!events(&ticks).iter().any(is_lost));
}

#[test]
fn a_robot_that_is_restarted_at_another_place_of_its_saved_map_finds_itself() {
    let mut drive = Drive::begin(&["--map", "{}/home.map"]);
    drive.drives_on();
    drive.ends_at_the_true_place("run");
    let there = two_metres_from(drive.home(), &drive.home().pose());
    drive.home().handle(&Handled::Carried(there)).unwrap();
    let args = ["--map", "{}/home.map"].map(|arg| in_folder(arg, drive.scene.folder.path()));
    drive.scene.robot = start(&drive.scene.world, drive.scene.folder.path(), "second", &args);
    drive.is_lost_and_found();
    drive.drives_on();
    let ticks = drive.ends_at_the_true_place("second");
    assert_lost_then_found(&ticks, |why| why == LostReason::Loaded);
}
