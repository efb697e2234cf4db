use std::path::Path;

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
fn the_documented_default_file_is_the_default_and_an_empty_file_too() {
    let documented = parse(DEFAULT_FILE).unwrap();
    let [documented_lines, default_lines] =
        [&documented, &Config::default()].map(|config| config.to_toml().unwrap());
    for (documented, default) in documented_lines.lines().zip(default_lines.lines()) {
        assert_eq!(
            documented, default,
            "robot.default.toml (left) differs from the default in the code (right)"
        );
    }
    assert_eq!(documented, Config::default());
    assert_eq!(parse("").unwrap(), Config::default());
}

#[test]
fn the_default_file_has_every_key_and_states_every_range() {
    let known = toml::Table::try_from(Config::default()).unwrap();
    let documented: toml::Table = toml::from_str(DEFAULT_FILE).unwrap();
    let (mut known_keys, mut documented_keys) = (Vec::new(), Vec::new());
    check::leaves(&known, "", &mut known_keys);
    check::leaves(&documented, "", &mut documented_keys);
    assert_eq!(known_keys, documented_keys);
    let mut section = "";
    for line in DEFAULT_FILE.lines() {
        if let Some((name, _)) = line.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            section = name;
        } else if let Some((name, rest)) = line.split_once(" = ") {
            let name = name.trim();
            match limits::of(&format!("{section}.{name}")) {
                Some(limit) => {
                    assert!(rest.contains(&format!("# {limit}")), "{section}.{name}: {limit}")
                }
                None => assert!(rest.contains("# "), "{section}.{name} is not explained"),
            }
        }
    }
}

#[test]
fn every_number_has_a_limit_and_every_limit_a_number_within_it() {
    fn numbers(table: &toml::Table, prefix: &str, into: &mut Vec<(String, f64)>) {
        for (name, value) in table {
            let key = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
            match value {
                toml::Value::Table(inner) => numbers(inner, &key, into),
                toml::Value::Integer(number) => into.push((key, *number as f64)),
                toml::Value::Float(number) => into.push((key, *number)),
                toml::Value::Array(numbers) => {
                    // A list that is empty by default may still have a limit.
                    let number = numbers
                        .first()
                        .map_or(limits::of(&key).map(|_| 0.0), toml::Value::as_float);
                    into.extend(number.map(|number| (key, number)));
                }
                _ => {}
            }
        }
    }
    let mut found = Vec::new();
    numbers(&toml::Table::try_from(Config::default()).unwrap(), "", &mut found);
    // What drivers are given they check themselves.
    found.retain(|(key, _)| !key.starts_with("devices."));
    for (key, value) in &found {
        assert!(
            limits::of(key).unwrap_or_else(|| panic!("{key} has no limit")).allows(*value),
            "{key} = {value}"
        );
    }
    assert_eq!(found.len(), limits::LIMITS.len());
}

#[test]
fn a_typing_error_is_refused_with_file_line_and_the_key_that_was_meant() {
    let error = refusal("[camera]\nwidth = 640\n\n[exploration]\nfrontier_frame = 3\n");
    assert_eq!(
        error,
        "unknown key `exploration.frontier_frame` in robot.toml line 5: did you mean `frontier_frames`?"
    );
}

#[test]
fn a_key_in_the_wrong_section_is_sent_to_the_right_one() {
    let error = refusal("[camera]\nfootprint_radius_m = 0.2\n");
    assert!(error.ends_with("line 2: did you mean `base.footprint_radius_m`?"), "{error}");
}

#[test]
fn a_key_like_nothing_else_is_answered_with_the_keys_that_exist() {
    let error = refusal("[lidar]\nqqqq = 1\n");
    assert!(error.ends_with("line 2: the keys of `lidar` are `forward_m`, `height_m`"), "{error}");
    let error = refusal("[zzzzzzzzz]\na = 1\n");
    assert!(
        error.contains("unknown key `zzzzzzzzz`") && error.contains("the sections are `base`"),
        "{error}"
    );
}

#[test]
fn a_value_out_of_range_is_refused_with_its_range() {
    let error = refusal("[base]\nfootprint_radius_m = 7.5\n");
    assert_eq!(
        error,
        "`base.footprint_radius_m = 7.5` in robot.toml line 2 is not possible: allowed is 0.05 to 1 metres"
    );
    assert!(refusal("camera.width = -640").contains("`camera.width = -640` in robot.toml line 1"));
    assert!(
        refusal("camera.width = 0x1_0000").contains("allowed is a whole number, 64 to 4096 pixels")
    );
}

#[test]
fn nan_and_infinity_are_refused() {
    for value in ["nan", "-nan", "inf", "-inf", "1e400"] {
        let error = refusal(&format!("camera.height_m = {value}"));
        assert!(error.contains("allowed is 0.05 to 3 metres"), "{value}: {error}");
    }
}

#[test]
fn all_problems_are_told_at_once_in_the_order_of_the_file() {
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
            .ends_with("line 1 is not possible: allowed is true or false")
    );
    assert!(refusal("camera = 3").contains("allowed is a table"));
    assert_eq!(parse("base.turn_step_deg = 2").unwrap(), Config::default());
}

#[test]
fn broken_syntax_names_file_and_line() {
    let error = refusal("[camera]\nwidth 640\n");
    assert!(error.starts_with("robot.toml: ") && error.contains("line 2"), "{error}");
}

#[test]
fn values_that_contradict_each_other_are_refused() {
    let error = refusal("[safety]\nback_off_m = 1.0\nback_off_timeout_s = 2.0\n");
    assert!(error.contains("[safety]: `back_off_m = 1` takes 3.3 s"), "{error}");
}

#[test]
fn what_a_part_of_the_runtime_refuses_is_refused_here_with_the_file() {
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
fn every_element_of_a_list_must_be_possible() {
    for list in ["[6.0, -1.0]", "[6.0, nan]", "[\"six\"]", "6.0"] {
        let error = refusal(&format!("coarse.parallax_px = {list}"));
        assert!(
            error.ends_with("line 1 is not possible: allowed is a list of 0.5 to 200 pixels"),
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
        error.contains("line 2") && error.contains("`hits`") && error.contains("`hits-and-free`"),
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
fn what_is_printed_loads_as_the_same_configuration() {
    let config = parse("[simulator.nuisances]\npeople = 3\n[base]\nturn_step_deg = 1.7\n").unwrap();
    assert_eq!(parse(&config.to_toml().unwrap()).unwrap(), config);
}

#[test]
fn the_assembled_safety_plane_is_its_own_default() {
    let (ours, theirs) = (Config::default().safety_config(), SafetyConfig::default());
    let speeds = |config: &SafetyConfig| [config.back_off_mps, config.escape_radps];
    for (ours, theirs) in speeds(&ours).into_iter().zip(speeds(&theirs)) {
        assert!((ours - theirs).abs() < 1e-12);
    }
    assert_eq!(
        SafetyConfig { back_off_mps: 0.0, escape_radps: 0.0, ..ours },
        SafetyConfig { back_off_mps: 0.0, escape_radps: 0.0, ..theirs }
    );
}

#[test]
fn the_assembled_planner_and_follower_are_their_own_defaults_with_this_robots_footprint() {
    let config = Config::default();
    let theirs =
        PlanConfig { footprint_radius_m: config.base.footprint_radius_m, ..PlanConfig::default() };
    assert_eq!(config.plan_config(), theirs);
    assert_eq!(config.follower_config(), FollowerConfig::default());
}

#[test]
fn the_default_scanner_is_the_data_sheets() {
    assert_eq!(Config::default().simulator.laser_model(), simulator::laser::LaserModel::UTM_30LX);
}

#[test]
fn the_default_camera_is_the_papers() {
    let model = Config::default().camera.model();
    assert!((model.fx - 320.0).abs() < 1e-9);
    assert_eq!((model.cx, model.cy), (319.5, 95.5));
}

#[test]
fn one_action_a_tick_gives_the_speed() {
    let base = Config::default().base;
    assert!((base.forward().integrate(base.tick_s()).x_m - 0.03).abs() < 1e-12);
    assert!((base.turn_radps().to_degrees() - 20.0).abs() < 1e-9);
    assert_eq!(base.tick_ns(), 100_000_000);
}

#[test]
fn a_corner_outside_of_the_circle_that_the_planner_keeps_clear_is_refused() {
    let error = refusal("base.footprint_m = [[0.3, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.3, -0.1]]");
    assert!(error.contains("`footprint_radius_m = 0.16`") && error.contains("0.316"), "{error}");
    assert!(refusal("base.footprint_m = [[0.1, 0.1]]").contains("at least three"));
}

#[test]
fn corners_are_checked_one_by_one() {
    for corners in ["[[0.1, 0.1], [7.0, 0.1], [0.0, 0.0]]", "[[0.1, nan]]", "[[true, 0.1]]"] {
        let error = refusal(&format!("base.footprint_m = {corners}"));
        assert!(
            error.ends_with("line 1 is not possible: allowed is a list of -1 to 1 metres"),
            "{error}"
        );
    }
}
