use std::path::Path;

use drivers::v4l2::Setting;
use hal::RobotDescription;
use hal::settings::{Kind, Section};
use runtime::{
    planning::{FollowerConfig, PlanConfig},
    safety::SafetyConfig,
};

use super::*;

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse(text, Path::new("robot.toml"))
}

fn refusal(text: &str) -> String {
    parse(text).unwrap_err().to_string()
}

#[test]
fn the_default_file_and_an_empty_file_are_the_default() {
    let documented = parse(DEFAULT_FILE).unwrap();
    assert_eq!(documented, Config::default());
    assert_eq!(documented.to_toml().unwrap(), Config::default().to_toml().unwrap());
    assert_eq!(parse("").unwrap(), Config::default());
}

#[test]
fn every_default_is_within_its_range() {
    assert_eq!(Config::default().check_ranges(), Ok(()));
    assert_eq!(check::together(&Config::default()), []);
}

/// The dotted names of the keys that a configuration is written with.
fn written_names(table: &toml::Table, prefix: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (name, value) in table {
        let path = check::join(prefix, name);
        match value {
            toml::Value::Table(inner) => names.extend(written_names(inner, &path)),
            _ => names.push(path),
        }
    }
    names
}

#[test]
fn the_declarations_name_exactly_the_keys_that_serde_reads_and_writes() {
    let mut config = Config::default();
    // These keys are absent by default.
    config.devices.camera.exposure_us = Some(Setting::Auto);
    config.devices.camera.gain = Some(Setting::Auto);
    config.devices.camera.white_balance_k = Some(Setting::Auto);
    config.devices.lidar.rplidar.baud = Some(115_200);
    config.devices.lidar.rplidar.rotation_hz = Some(7.0);
    let mut written = written_names(&toml::Table::try_from(config).unwrap(), "");
    let mut declared = check::full_names(&Config::SECTION, "");
    written.sort();
    declared.sort();
    assert_eq!(written, declared);
}

/// Every key with a list of choices, and its choices.
fn choices(section: &Section, prefix: &str) -> Vec<(String, &'static [&'static str])> {
    let mut found = Vec::new();
    for key in section.keys {
        let path = check::join(prefix, key.name);
        match key.kind {
            Kind::Table(inner) => found.extend(choices(inner, &path)),
            Kind::Choice(choices) => found.push((path, choices)),
            _ => {}
        }
    }
    found
}

#[test]
fn every_declared_choice_can_be_read() {
    let choices = choices(&Config::SECTION, "");
    assert_eq!(choices.len(), 13);
    for (key, choices) in choices {
        for choice in choices {
            // Some combinations are refused by a rule between keys, which is checked after reading.
            let text = format!("{key} = \"{choice}\"");
            toml::from_str::<Config>(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
        }
    }
}

#[test]
fn a_renamed_key_is_refused_with_its_new_name() {
    assert_eq!(
        refusal("[recording]\npictures = false\n"),
        "`recording.pictures` in robot.toml line 2 is now called `recording.images`"
    );
    assert!(refusal("run.picture_timeout_s = 2.0").ends_with("called `run.frame_timeout_s`"));
    assert!(refusal("models.trial_turns = 60").ends_with("called `models.trial_ticks`"));
    assert!(refusal("[bumper]\nstop_distance_m = 0.2").ends_with("is now called `safety`"));
}

#[test]
fn a_recording_with_the_former_name_of_a_key_can_be_read() {
    let config: Config = serde_json::from_str(r#"{"recording": {"pictures": false}}"#).unwrap();
    assert!(!config.recording.images);
}

#[test]
fn an_unknown_key_is_refused_with_file_line_and_the_similar_key() {
    let error = refusal("[camera]\nwidth = 640\n\n[exploration]\nfrontier_frame = 3\n");
    assert_eq!(
        error,
        "unknown key `exploration.frontier_frame` in robot.toml line 5: did you mean `frontier_frames`?"
    );
}

#[test]
fn a_key_in_the_wrong_section_is_refused_with_the_right_section() {
    let error = refusal("[camera]\nfootprint_radius_m = 0.2\n");
    assert!(error.ends_with("line 2: did you mean `base.footprint_radius_m`?"), "{error}");
}

#[test]
fn an_unknown_key_without_a_similar_one_is_refused_with_the_keys_of_the_section() {
    let error = refusal("[lidar]\nqqqq = 1\n");
    assert!(
        error.ends_with(
            "line 2: the keys of `lidar` are `height_m`, `forward_m`, `left_m`, `yaw_deg`"
        ),
        "{error}"
    );
    let error = refusal("[zzzzzzzzz]\na = 1\n");
    assert!(
        error.contains("unknown key `zzzzzzzzz`") && error.contains("the sections are `camera`"),
        "{error}"
    );
}

#[test]
fn a_value_out_of_range_is_refused_with_its_range() {
    let error = refusal("[base]\nfootprint_radius_m = 7.5\n");
    assert_eq!(
        error,
        "`base.footprint_radius_m = 7.5` in robot.toml line 2 is not allowed: it must be 0.05 to 1.0 m"
    );
    assert!(refusal("camera.width = -640").contains("`camera.width = -640` in robot.toml line 1"));
    assert!(
        refusal("camera.width = 0x1_0000").contains("it must be a whole number, 64 to 4096 pixels")
    );
}

#[test]
fn nan_and_infinity_are_refused() {
    for value in ["nan", "-nan", "inf", "-inf", "1e400"] {
        let error = refusal(&format!("camera.height_m = {value}"));
        assert!(error.contains("it must be 0.05 to 3.0 m"), "{value}: {error}");
    }
}

#[test]
fn all_problems_are_reported_at_once_in_the_order_of_the_file() {
    let error = refusal("[lidar]\nheight = 1\n[camera]\nwidth = 1\n[base]\ntick = 1\n");
    let lines: Vec<&str> = error.lines().collect();
    assert_eq!(lines.len(), 3, "{error}");
    assert!(
        lines[0].contains("line 2") && lines[1].contains("line 4") && lines[2].contains("line 6"),
        "{error}"
    );
}

#[test]
fn a_value_of_another_type_is_refused_with_what_is_allowed() {
    for value in ["\"wide\"", "640.5", "true", "[640]", "{ px = 640 }", "2026-01-01"] {
        let error = refusal(&format!("[camera]\nwidth = {value}\n"));
        assert!(
            error.contains("line 2") && error.contains("a whole number, 64 to 4096 pixels"),
            "{value}: {error}"
        );
    }
    assert!(
        refusal("simulator.sliding = 1")
            .ends_with("line 1 is not allowed: it must be true or false")
    );
    assert!(refusal("camera = 3").contains("it must be a table"));
    assert_eq!(parse("base.turn_step_deg = 4").unwrap(), Config::default());
}

#[test]
fn broken_syntax_names_file_and_line() {
    let error = refusal("[camera]\nwidth 640\n");
    assert!(error.starts_with("robot.toml: ") && error.contains("line 2"), "{error}");
}

#[test]
fn values_that_contradict_each_other_are_refused_together() {
    let error = refusal("[safety]\nback_off_m = 1.0\nback_off_timeout_s = 2.0\n");
    assert!(error.contains("[safety]: `back_off_m = 1` takes 3.3 s"), "{error}");
}

#[test]
fn what_a_part_of_the_runtime_refuses_is_refused_with_the_name_of_the_file() {
    for (text, part) in [
        ("coarse.penalty_large = 1", "[coarse]"),
        ("map.side_cells = 100", "[map]"),
        ("planning.correct_deg = 1.0", "[planning]"),
    ] {
        let error = refusal(text);
        assert!(error.starts_with(&format!("robot.toml: {part}: ")), "{error}");
    }
}

#[test]
fn every_element_of_a_list_is_checked() {
    for list in ["[6.0, -1.0]", "[6.0, nan]", "[\"six\"]", "6.0"] {
        let error = refusal(&format!("coarse.parallax_px = {list}"));
        assert!(
            error.ends_with("line 1 is not allowed: it must be a list, each 0.5 to 200.0 pixels"),
            "{error}"
        );
    }
    assert_eq!(
        parse("coarse.parallax_px = [5, 10, 20.5]").unwrap().coarse.parallax_px,
        [5.0, 10.0, 20.5]
    );
}

#[test]
fn a_choice_that_does_not_exist_is_refused_with_the_choices() {
    let error = refusal("[map]\nlidar = \"hit\"\n");
    assert!(
        error.ends_with("line 2 is not allowed: it must be \"off\", \"hits\" or \"hits-and-free\""),
        "{error}"
    );
}

#[test]
fn a_missing_file_is_named() {
    let error = Config::load(Path::new("/nowhere/robot.toml")).unwrap_err();
    assert!(matches!(error, ConfigError::Unreadable { .. }));
    assert!(error.to_string().contains("/nowhere/robot.toml"));
}

#[test]
fn a_written_configuration_is_read_as_the_same() {
    let config = parse("[simulator.nuisances]\npeople = 3\n[base]\nturn_step_deg = 1.7\n").unwrap();
    assert_eq!(parse(&config.to_toml().unwrap()).unwrap(), config);
}

#[test]
fn the_safety_plane_of_the_default_configuration_is_the_default_one() {
    let ours = Config::default().safety_config();
    let theirs = SafetyConfig::default();
    // Derived speeds differ by a rounding error.
    assert!((ours.back_off_mps - theirs.back_off_mps).abs() < 1e-12);
    assert!((ours.escape_radps - theirs.escape_radps).abs() < 1e-12);
    assert_eq!(
        SafetyConfig { back_off_mps: 0.0, escape_radps: 0.0, ..ours },
        SafetyConfig { back_off_mps: 0.0, escape_radps: 0.0, ..theirs }
    );
}

#[test]
fn the_planner_and_the_follower_of_the_default_configuration_are_the_default_ones() {
    let config = Config::default();
    assert_eq!(config.plan_config(), PlanConfig::default());
    assert_eq!(config.follower_config(), FollowerConfig::default());
}

#[test]
fn planner_safety_plane_and_simulator_use_one_robot_description() {
    let config = Config::default();
    let robot = RobotDescription::default();
    assert_eq!(config.robot_description(), robot);
    assert_eq!(config.plan_config().footprint_radius_m, robot.footprint_radius_m);
    assert_eq!(config.safety_config().footprint_radius_m, robot.footprint_radius_m);
    assert_eq!(simulator::floor::Footprint::default().radius_m, robot.footprint_radius_m);
    assert_eq!(config.camera.t_base_camera(), robot.camera.t_base_camera());
    assert_eq!(simulator::RobotOptions::default().t_base_camera, robot.camera.t_base_camera());
    assert_eq!(simulator::RobotOptions::default().t_base_laser, robot.lidar.t_base_laser_3d());
}

#[test]
fn the_configuration_of_the_package_is_allowed() {
    let text = include_str!("../../packaging/robot.toml");
    let config = Config::parse(text, Path::new("packaging/robot.toml")).unwrap();
    // The endpoints of the installed firmware are the only value that a person must fill in.
    let error = config.check_devices(Path::new("packaging/robot.toml")).unwrap_err().to_string();
    assert!(error.contains("odrive.enable_watchdog_endpoint"), "{error}");
}

#[test]
fn a_number_of_a_driver_is_refused_with_file_and_line() {
    let error = refusal("[devices.base]\ntrack_m = 30.0\n");
    assert!(error.contains("line 2 is not allowed: it must be 0.03 to 3.0 m"), "{error}");
    let error = refusal("devices.camera.exposure_us = 5");
    assert!(error.ends_with("\"auto\" or a whole number, 100 to 10000000 us"), "{error}");
    assert!(parse("devices.camera.exposure_us = \"auto\"").is_ok());
}

#[test]
fn a_number_without_a_range_must_be_finite() {
    let error = refusal("devices.lens.distortion = [nan]");
    assert!(error.ends_with("it must be a list, each a number"), "{error}");
    let body = "safety.body = [{ from_deg = nan, to_deg = 1, up_to_m = 0.1 }]";
    assert!(refusal(body).contains("not finite"));
}

#[test]
fn the_default_scanner_is_the_one_of_the_data_sheet() {
    let config = Config::default();
    let laser = config.simulator.laser_model(&config.devices.lidar);
    assert_eq!(laser, simulator::laser::LaserModel::UTM_30LX);
}

#[test]
fn a_simulated_robot_has_the_scanner_of_its_configuration_and_a_safety_plane_that_waits_for_it() {
    let mut config = Config::default();
    assert_eq!(config.simulated_safety_config().reaction_s, 0.0);
    config.devices.lidar.kind = drivers::lidar::LidarKind::Ld06;
    let laser = config.simulator.laser_model(&config.devices.lidar);
    assert_eq!((laser.geometry.beams, laser.geometry.period_ns), (400, 100_000_000));
    assert!(laser.geometry.clockwise);
    let safety = config.simulated_safety_config();
    // Three scans of 115 ms and 30 ms on the cable, instead of two scans of 25 ms.
    assert!((safety.reaction_s - 0.325).abs() < 1e-9, "{}", safety.reaction_s);
    assert!((safety.lateral_margin_m - 0.045).abs() < 1e-9);
}

#[test]
fn the_default_camera_is_the_camera_of_the_paper() {
    let model = Config::default().camera.model();
    assert!((model.fx - 320.0).abs() < 1e-9);
    assert_eq!((model.cx, model.cy), (319.5, 95.5));
}

#[test]
fn one_action_per_tick_is_the_speed() {
    let base = Config::default().base;
    assert!((base.forward().integrate(base.tick_s()).x_m - 0.03).abs() < 1e-12);
    assert!((base.turn_radps().to_degrees() - 40.0).abs() < 1e-9);
    assert_eq!(base.tick_ns(), 100_000_000);
}

#[test]
fn a_corner_outside_of_the_footprints_circle_is_refused() {
    let error = refusal("base.footprint_m = [[0.3, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.3, -0.1]]");
    assert!(error.contains("`footprint_radius_m = 0.16`") && error.contains("0.316"), "{error}");
    assert!(refusal("base.footprint_m = [[0.1, 0.1]]").contains("at least three"));
}

#[test]
fn corners_are_checked_one_by_one() {
    for corners in ["[[0.1, 0.1], [7.0, 0.1], [0.0, 0.0]]", "[[0.1, nan]]", "[[true, 0.1]]"] {
        let error = refusal(&format!("base.footprint_m = {corners}"));
        assert!(
            error.ends_with(
                "line 1 is not allowed: it must be a list, each a list of 2, each -1.0 to 1.0 m"
            ),
            "{error}"
        );
    }
}

#[test]
fn a_section_that_is_there_twice_is_refused_with_the_way_out() {
    let text = "devices.camera.width = 640\n[devices.camera]\nlatency_ms = 40.0\n";
    let error = refusal(text);
    assert!(error.contains("line 2") && error.contains("duplicate key: "), "{error}");
    assert!(error.contains("`devices.camera.latency_ms = 40`"), "{error}");
}
