//! A robot with an inertial measurement unit.

use firmware_host::recorded::Recorded;
use hal::wrap_angle;

use super::scene::Scene;

fn is_working(scene: &Scene) -> bool {
    let imu = scene.status().and_then(|status| status.imu);
    imu.is_some_and(|imu| imu.state == "working")
}

#[test]
fn a_robot_drives_on_without_its_inertial_unit_and_uses_it_again_when_it_is_back() {
    let mut scene = Scene::with_imu();
    scene.drives_first();
    scene.wait("samples of the unit", is_working);
    scene.drives("driving with the unit");

    scene.world.plug_imu(false);
    scene.wait("a unit that is gone", |scene| !is_working(scene));
    let (well, text) = scene.health();
    assert!(!well && text.contains("! IMU unix:"), "{text}");
    scene.drives("driving without the unit");

    scene.world.plug_imu(true);
    scene.wait("samples after the unit was plugged in again", is_working);
    scene.drives("driving with the unit again");
    scene.ends_well();

    let recorded = Recorded::open(&scene.path("run")).unwrap();
    let ticks: Vec<_> = recorded.ticks().map(Result::unwrap).collect();
    let gaps: Vec<_> = ticks.iter().filter_map(|tick| Some(tick.imu?.gaps)).collect();
    assert!(gaps.first() < gaps.last(), "the interruption is counted: {gaps:?}");
    assert!(gaps.len() < ticks.len(), "there are ticks without angles");
    // The wheels report the same rotations, up to their noise and the bias.
    for pair in ticks.windows(2) {
        let [Some(before), Some(after)] = [pair[0].imu, pair[1].imu] else { continue };
        if before.gaps != after.gaps {
            continue;
        }
        let by_wheels = wrap_angle(pair[1].wheel.odom.yaw_rad - pair[0].wheel.odom.yaw_rad);
        let by_gyro = after.yaw_rad - before.yaw_rad;
        let seconds = 1e-9 * (pair[1].wheel.time_ns - pair[0].wheel.time_ns) as f64;
        let most_rad = 0.03 + 0.2 * by_wheels.abs() + 0.1 * seconds;
        assert!((by_gyro - by_wheels).abs() < most_rad, "tick {}", pair[1].tick);
        assert!(after.tilt_rad.unwrap() < 0.1, "tick {}", pair[1].tick);
    }
}
