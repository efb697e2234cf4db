//! From configuration and arguments to a simulated robot.

use hal::Pose2;
use runtime::safety::SafetyConfig;
use simulator::floor::Footprint;
use simulator::load::{LoadOptions, UpAxis};
use simulator::robot::Change;
use simulator::{OpenOptions, RobotOptions, SceneError, World};

use crate::cli::{SceneFileArgs, UpArg};
use crate::config::{Config, TruthSection};

impl Config {
    /// The safety plane's configuration in simulation: the simulated base answers at once and stops within a step.
    #[must_use]
    pub fn simulated_safety_config(&self) -> SafetyConfig {
        let safety = self.safety_config();
        SafetyConfig {
            lateral_margin_m: safety.lateral_margin_m.max(self.devices.lidar.accuracy_m()),
            // A simulated base stops at once, and the default scanner counts as one that sees at once. On the safe side, this
            // includes the time on the cable of a slower one.
            reaction_s: (self.sight_s() - Self::default().sight_s()).max(0.0),
            good_scans: self.run.good_scans,
            feedback_timeout_s: self.run.feedback_timeout_s,
            plan_timeout_s: self.run.plan_timeout_s,
            period_s: 1.0 / self.run.safety_hz,
            ..safety
        }
    }
}

/// The simulated robot that the configuration describes.
#[must_use]
pub fn simulated_robot(config: &Config, seed: u64, start: Option<Pose2>) -> RobotOptions {
    let simulator = &config.simulator;
    let truth = &simulator.truth;
    if truth.changes_after_m > 0.0 {
        let change = Some(change(config, truth));
        let mut before = config.clone();
        before.simulator.truth = TruthSection::default();
        return RobotOptions { change, ..simulated_robot(&before, seed, start) };
    }
    RobotOptions {
        camera: config.camera.model(),
        t_base_camera: simulator.truth.camera(config.camera.mount()).t_base_camera(),
        t_base_laser: simulator.truth.lidar(config.lidar.mount()).t_base_laser_3d(),
        sliding: simulator.sliding,
        odometry: simulator.odometry_noise(),
        laser: simulator.laser_model(&config.devices.lidar),
        nuisances: simulator.nuisances.clone(),
        camera_latency_s: simulator.latency_s(),
        camera_late_s: simulator.truth.camera_late_s,
        lidar_late_s: simulator.truth.lidar_late_s,
        focal_scale: 1.0 + simulator.truth.focal_percent / 100.0,
        rolling_shutter_s: simulator.rolling_shutter_s,
        floor_tilt_rad: simulator.floor_tilt_deg.to_radians(),
        cliff_sensors: simulator.cliff_sensors,
        seed,
        start,
        ..RobotOptions::default()
    }
}

/// How the robot really is.
fn change(config: &Config, truth: &TruthSection) -> Change {
    Change {
        after_m: truth.changes_after_m,
        t_base_camera: truth.camera(config.camera.mount()).t_base_camera(),
        t_base_laser: truth.lidar(config.lidar.mount()).t_base_laser_3d(),
        wheels: truth.wheels(),
        camera_late_s: truth.camera_late_s,
        lidar_late_s: truth.lidar_late_s,
        focal_scale: 1.0 + truth.focal_percent / 100.0,
    }
}

/// Heights of ceilings of rooms that are measured in metres.
const USUAL_CEILING_M: std::ops::RangeInclusive<f64> = 1.9..=6.0;
/// No home or office has more floor that one robot can reach on one storey, square metres.
const LARGE_FLOOR_M2: f64 = 1000.0;
/// What a scale is suggested for, metres.
const ORDINARY_CEILING_M: f64 = 2.5;
/// Number of places at which the height of the ceiling is measured.
const CEILING_PLACES: usize = 200;

/// Opens the scene that the arguments speak of. Warns if it does not look like rooms.
///
/// # Errors
/// The scene does not exist, is damaged, or has no floor.
pub fn open(scene: &str, file: &SceneFileArgs, config: &Config) -> Result<World, SceneError> {
    let world = World::open(scene, &open_options(file, config))?;
    if let Some(doubt) = doubt(&world, file) {
        tracing::warn!("{doubt}");
    }
    Ok(world)
}

/// Why a scene file is probably opened with a wrong axis or scale, with the numbers and what to try; `None` if it looks like
/// rooms.
fn doubt(world: &World, file: &SceneFileArgs) -> Option<String> {
    // A built-in home has no axis in a file.
    world.origin().up_axis?;
    let floor_m2 = world.floor_plan().reachable_floor_m2();
    let ceiling_m = ceiling_m(world);
    let is_usual = ceiling_m.is_none_or(|height_m| USUAL_CEILING_M.contains(&height_m));
    if is_usual && floor_m2 <= LARGE_FLOOR_M2 {
        return None;
    }
    let seen = ceiling_m.map_or_else(
        || "has no ceiling".to_owned(),
        |height_m| format!("has a ceiling at {height_m:.2} m"),
    );
    let scale = ceiling_m.map(|height_m| file.scene_scale * ORDINARY_CEILING_M / height_m);
    let scale = scale.map_or_else(String::new, |scale| {
        format!(" (a ceiling at {ORDINARY_CEILING_M} m needs {})", two_digits(scale))
    });
    Some(format!(
        "the scene {seen} and {floor_m2:.0} m2 of floor that the robot can reach: if these are no real rooms in metres, try \
         another --scene-scale{scale} or --scene-up"
    ))
}

/// Median height of the ceiling above the reachable floor; `None` if most of it is under the sky.
fn ceiling_m(world: &World) -> Option<f64> {
    let floor: Vec<[f64; 2]> = world.floor_plan().reachable_floor().collect();
    let places = floor.iter().step_by((floor.len() / CEILING_PLACES).max(1));
    let mut heights: Vec<f64> = places
        .map(|[x_m, y_m]| {
            let up = world.renderer().cast([*x_m, *y_m, 0.05], [0.0, 0.0, 1.0], 1e6, &[]);
            up.map_or(f64::INFINITY, |height_m| height_m + 0.05)
        })
        .collect();
    heights.sort_by(f64::total_cmp);
    heights.get(heights.len() / 2).copied().filter(|height_m| height_m.is_finite())
}

/// A number with two digits, such as 0.0096 or 250.
fn two_digits(number: f64) -> String {
    let last_place = number.abs().log10().floor() - 1.0;
    let unit = 10f64.powf(last_place);
    let decimals = (-last_place).max(0.0) as usize;
    format!("{:.decimals$}", (number / unit).round() * unit)
}

/// How to open the scene that the arguments speak of.
fn open_options(file: &SceneFileArgs, config: &Config) -> OpenOptions {
    let up_axis = match file.scene_up {
        None => UpAxis::Auto,
        Some(UpArg::Y) => UpAxis::Y,
        Some(UpArg::Z) => UpAxis::Z,
    };
    let footprint = Footprint { radius_m: config.base.footprint_radius_m, ..Footprint::default() };
    OpenOptions { load: LoadOptions { up_axis, scale: file.scene_scale }, footprint }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rooms of 5 x 6 m that are 2.5 m high, as OBJ with z up.
    fn doubt_about(up: UpArg, scale: f64) -> Option<String> {
        let corners = [(0, 0), (10, 0), (10, 6), (0, 6), (5, 0), (5, 2), (5, 4), (5, 6)];
        let mut text = String::new();
        for height_m in ["0", "2.5"] {
            for (x_m, y_m) in corners {
                text += &format!("v {x_m} {y_m} {height_m}\n");
            }
        }
        text += "f 1 2 3 4\nf 9 10 11 12\n";
        for (from, to) in [(1, 2), (2, 3), (3, 4), (4, 1), (5, 6), (7, 8)] {
            text += &format!("f {from} {to} {} {}\n", to + 8, from + 8);
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rooms.obj");
        std::fs::write(&path, text).unwrap();
        let file = SceneFileArgs { scene_up: Some(up), scene_scale: scale };
        let options = open_options(&file, &Config::default());
        doubt(&World::open(&path.to_string_lossy(), &options).unwrap(), &file)
    }

    #[test]
    fn rooms_in_metres_raise_no_doubt() {
        assert_eq!(doubt_about(UpArg::Z, 1.0), None);
    }

    #[test]
    fn a_hall_of_a_wrong_scale_is_doubted_with_its_size_and_a_better_scale() {
        let said = doubt_about(UpArg::Z, 4.0).unwrap();
        for part in
            ["ceiling at 10.00 m", " m2 of floor", "--scene-scale (a ceiling at 2.5 m needs 1.0"]
        {
            assert!(said.contains(part), "{part} is not in {said}");
        }
    }

    #[test]
    fn a_robot_that_drives_on_a_wall_is_doubted() {
        // With y up, the room is 6 m high and 2.5 m wide; only a larger home exceeds the usual height.
        let said = doubt_about(UpArg::Y, 1.5).unwrap();
        assert!(said.contains("ceiling at 9.00 m") && said.contains("--scene-up"), "{said}");
    }

    #[test]
    fn a_suggested_scale_has_two_digits() {
        assert_eq!(format!("{} {}", two_digits(0.009_615), two_digits(253.0)), "0.0096 250");
    }
}
