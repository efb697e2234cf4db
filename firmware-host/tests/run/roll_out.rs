//! How far the wheels roll when the program is killed.

use std::time::Instant;

use drivers::can::{BaseConfig, Protocol};
use hil::motor::wheel::STANDING_RADPS;
use hil::motor::{MotorNode, rig};
use rustix::process::Signal;

use super::scene::{PATIENCE, Scene, pause};

/// A wheel since the last command that its controller has received.
#[derive(Debug, Clone, Copy, Default)]
struct Rolling {
    commanded_ns: u64,
    commanded_at_m: f64,
    at_m: f64,
    speed_mps: f64,
    fastest_mps: f64,
}

impl Rolling {
    fn observe(&mut self, node: &dyn MotorNode, radius_m: f64) {
        self.at_m = node.wheel().position_rad() * radius_m;
        self.speed_mps = node.wheel().velocity_radps().abs() * radius_m;
        if self.commanded_ns != node.watchdog().fed_ns {
            self.commanded_ns = node.watchdog().fed_ns;
            self.commanded_at_m = self.at_m;
            self.fastest_mps = 0.0;
        }
        self.fastest_mps = self.fastest_mps.max(self.speed_mps);
    }
}

fn observe(wheels: &mut [Rolling; 2], scene: &Scene, base: &BaseConfig) {
    for (wheel, node) in wheels.iter_mut().zip(scene.world.wheels().iter()) {
        wheel.observe(node.as_ref(), base.wheel_radius_m);
    }
}

/// Kills the program while the robot drives straight ahead at nearly its full speed, and waits until both wheels stand.
fn rolls_out(scene: &mut Scene, base: &BaseConfig) -> [Rolling; 2] {
    let mut wheels = [Rolling::default(); 2];
    scene.wait("full speed", |scene| {
        observe(&mut wheels, scene, base);
        wheels.iter().all(|wheel| wheel.speed_mps > 0.9 * base.limits.linear_mps)
    });
    scene.signal(Signal::KILL);
    scene.robot.wait().unwrap();
    let began = Instant::now();
    while wheels.iter().any(|wheel| wheel.speed_mps > STANDING_RADPS * base.wheel_radius_m) {
        assert!(began.elapsed() < PATIENCE, "the wheels roll for ever: {wheels:?}");
        pause(1);
        observe(&mut wheels, scene, base);
    }
    wheels
}

/// After the last command the wheels keep their speed until the watchdog has expired, at most one control period later than that if
/// the command was on its way, and lose it then as the controller brakes or coasts: see `rig::decay_after_watchdog_s`. The simulated
/// motors notice the expiry in a step, which a busy computer delays.
#[test]
fn the_wheels_of_a_killed_program_roll_as_far_as_their_controllers_brake_or_coast() {
    for protocol in [Protocol::Odrive, Protocol::Vesc, Protocol::Cia402] {
        let base = rig::config(protocol);
        let mut scene = Scene::new(protocol);
        scene.drives_first();
        let wheels = rolls_out(&mut scene, &base);
        let watchdog_s = f64::from(base.watchdog_ms) * 1e-3;
        let late_s = 0.01 + 2.0 * scene.world.worst_late_ns() as f64 * 1e-9;
        let decay_s = rig::decay_after_watchdog_s(protocol);
        for wheel in wheels {
            let rolled_m = wheel.at_m - wheel.commanded_at_m;
            let most_m = 1.05 * wheel.fastest_mps * (watchdog_s + late_s + decay_s);
            println!(
                "{protocol:?}: {rolled_m:.3} m of {most_m:.3} m, {:.2} m/s",
                wheel.fastest_mps
            );
            assert!(
                rolled_m < most_m,
                "{protocol:?}: {rolled_m} m, more than {most_m} m: {wheel:?}"
            );
        }
    }
}
