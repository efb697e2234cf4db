//! Compares a file with the declarations of the keys, and checks the rules between keys.

use hal::settings::{Key, Kind, Range, Section};
use runtime::imaging::{FrontEnd, YuvRange};
use toml::de::{DeTable, DeValue};

use super::{Config, Problem};

/// Similarity (Damerau-Levenshtein, 0 to 1) from which an unknown name counts as a typing error of a known one.
const SIMILAR: f64 = 0.6;

/// Unknown keys and values that are not allowed, in the order of the file.
pub(super) fn file(document: &DeTable<'_>, text: &str) -> Vec<Problem> {
    let mut checker = Checker { text, problems: Vec::new() };
    checker.check_table(document, &Config::SECTION, "");
    checker.problems.sort_by_key(|(offset, _)| *offset);
    checker.problems.into_iter().map(|(_, problem)| problem).collect()
}

/// The time-out of scans is at least this many of the scanner's longest periods, because scans also wait in the computer.
const SPARE_TIME: f64 = 1.25;

struct Checker<'a> {
    text: &'a str,
    /// Each problem with the byte offset at which it begins.
    problems: Vec<(usize, Problem)>,
}

impl Checker<'_> {
    fn check_table(&mut self, given: &DeTable<'_>, section: &Section, prefix: &str) {
        for (name, value) in given {
            let offset = name.span().start;
            let line = self.line_of(offset);
            let name = name.get_ref().as_ref();
            let path = join(prefix, name);
            let Some(key) = section.keys.iter().find(|key| key.name == name) else {
                let problem = unknown(line, name, prefix, section);
                self.problems.push((offset, problem));
                continue;
            };
            if let (Kind::Table(section), DeValue::Table(given)) = (&key.kind, value.get_ref()) {
                self.check_table(given, section, &path);
                continue;
            }
            if is_allowed(value.get_ref(), &key.kind, key.range.as_ref()) {
                continue;
            }
            let problem = Problem::NotAllowed {
                line,
                key: path,
                value: written(value.get_ref()),
                allowed: allowed(key),
            };
            self.problems.push((offset, problem));
        }
    }

    fn line_of(&self, offset: usize) -> usize {
        1 + self.text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
    }
}

fn is_allowed(value: &DeValue<'_>, kind: &Kind, range: Option<&Range>) -> bool {
    match (kind, value) {
        (Kind::Bool, DeValue::Boolean(_)) | (Kind::Text, DeValue::String(_)) => true,
        (Kind::Integer | Kind::Number | Kind::AutoOrInteger, DeValue::Integer(_))
        | (Kind::Number, DeValue::Float(_)) => {
            let number = number(value);
            range.map_or(number.is_finite(), |range| range.allows(number))
        }
        (Kind::Choice(choices), DeValue::String(text)) => choices.contains(&text.as_ref()),
        (Kind::AutoOrInteger, DeValue::String(text)) => text == "auto",
        (Kind::List(element, length), DeValue::Array(given)) => {
            length.is_none_or(|length| length == given.len())
                && given.iter().all(|value| is_allowed(value.get_ref(), element, range))
        }
        (Kind::Other(_), _) => true,
        _ => false,
    }
}

/// The value as a number; NaN if it is not a number, or an integer that no integer type can hold.
fn number(value: &DeValue<'_>) -> f64 {
    match value {
        DeValue::Integer(integer) => i128::from_str_radix(integer.as_str(), integer.radix())
            .map_or(f64::NAN, |number| number as f64),
        DeValue::Float(float) => float.as_str().parse().unwrap_or(f64::NAN),
        _ => f64::NAN,
    }
}

/// The value as it is written in the file.
fn written(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Integer(integer) => integer.as_str().to_owned(),
        DeValue::Float(float) => float.as_str().to_owned(),
        DeValue::String(text) => format!("\"{text}\""),
        DeValue::Boolean(value) => value.to_string(),
        DeValue::Datetime(time) => time.to_string(),
        DeValue::Array(elements) => {
            let elements: Vec<String> =
                elements.iter().map(|element| written(element.get_ref())).collect();
            format!("[{}]", elements.join(", "))
        }
        DeValue::Table(_) => "{...}".to_owned(),
    }
}

/// The allowed values of a key, for messages and for the reference.
pub(super) fn allowed(key: &Key) -> String {
    describe(&key.kind, key.range.map_or("", |range| range.text))
}

fn describe(kind: &Kind, range: &str) -> String {
    match kind {
        Kind::Bool => "true or false".to_owned(),
        Kind::Integer if range.is_empty() => "a whole number".to_owned(),
        Kind::Integer => format!("a whole number, {range}"),
        Kind::Number if range.is_empty() => "a number".to_owned(),
        Kind::Number => range.to_owned(),
        Kind::Text => "a text in quotes".to_owned(),
        Kind::Choice(choices) => either(choices),
        Kind::AutoOrInteger => format!("\"auto\" or {}", describe(&Kind::Integer, range)),
        Kind::List(element, None) => format!("a list, each {}", describe(element, range)),
        Kind::List(element, Some(length)) => {
            format!("a list of {length}, each {}", describe(element, range))
        }
        Kind::Table(_) => "a table".to_owned(),
        Kind::Other(example) => format!("like {example}"),
    }
}

fn either(choices: &[&str]) -> String {
    let mut quoted: Vec<String> = choices.iter().map(|choice| format!("\"{choice}\"")).collect();
    let last = quoted.pop().unwrap_or_default();
    if quoted.is_empty() { last } else { format!("{} or {last}", quoted.join(", ")) }
}

fn unknown(line: usize, name: &str, prefix: &str, section: &Section) -> Problem {
    let path = join(prefix, name);
    if let Some(key) = section.keys.iter().find(|key| key.was == Some(name)) {
        return Problem::RenamedKey { line, key: path, now: join(prefix, key.name) };
    }
    Problem::UnknownKey { line, key: path, advice: advice(name, prefix, section) }
}

/// A similar key of the same section; else the same or a similar key of another section; else all keys of the section.
fn advice(name: &str, prefix: &str, section: &Section) -> String {
    let siblings = section.keys.iter().map(|key| key.name.to_owned());
    let everywhere = full_names(&Config::SECTION, "").into_iter();
    if let Some(similar) = most_similar(name, siblings).or_else(|| most_similar(name, everywhere)) {
        return format!("did you mean `{similar}`?");
    }
    let names: Vec<String> = section.keys.iter().map(|key| format!("`{}`", key.name)).collect();
    let names = names.join(", ");
    if prefix.is_empty() {
        format!("the sections are {names}")
    } else {
        format!("the keys of `{prefix}` are {names}")
    }
}

/// The candidate whose last part is most similar to `name`.
fn most_similar(name: &str, candidates: impl Iterator<Item = String>) -> Option<String> {
    candidates
        .map(|candidate| {
            let last = candidate.rsplit('.').next().unwrap_or(&candidate);
            (strsim::normalized_damerau_levenshtein(name, last), candidate)
        })
        .filter(|(similarity, _)| *similarity >= SIMILAR)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// Full dotted names of all keys below a section that are not sections.
pub(super) fn full_names(section: &Section, prefix: &str) -> Vec<String> {
    let mut names = Vec::new();
    for key in section.keys {
        let path = join(prefix, key.name);
        match &key.kind {
            Kind::Table(inner) => names.extend(full_names(inner, &path)),
            _ => names.push(path),
        }
    }
    names
}

pub(super) fn join(prefix: &str, name: &str) -> String {
    if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") }
}

/// Values that are not allowed together: the rules of each part of the runtime, and those between parts.
pub(super) fn together(config: &Config) -> Vec<Problem> {
    let problems = refused([
        ("coarse", config.coarse.validate().map_err(|error| error.to_string())),
        ("map", config.map.validate().map_err(|error| error.to_string())),
        ("planning", config.plan_config().validate().map_err(|error| error.to_string())),
        ("planning", config.follower_config().validate().map_err(|error| error.to_string())),
        ("safety", body_is_finite(config)),
        ("safety", back_off_ends_in_time(config)),
        ("base", corners_are_within_radius(config)),
        ("identity", name_is_a_word(config)),
    ]);
    problems.into_iter().chain(refused([("simulator.nuisances", nuisances(config))])).collect()
}

/// What the drivers refuse. A simulated robot has no drivers, so only `run` and `check --devices` ask.
pub(super) fn devices(config: &Config) -> Vec<Problem> {
    let devices = &config.devices;
    refused([
        ("devices.camera", devices.camera.check().map_err(|error| error.to_string())),
        ("devices.lens", frames_can_be_converted(config)),
        ("devices.lidar", devices.lidar.validate().map_err(|error| error.to_string())),
        ("safety", scans_arrive_in_time(config)),
        ("devices.base", devices.base.validate().map_err(|error| error.to_string())),
        ("devices.imu", devices.imu.validate().map_err(|error| error.to_string())),
        (
            "devices.emergency_stop",
            devices.emergency_stop.validate().map_err(|error| error.to_string()),
        ),
    ])
}

/// A scanner that works must not count as silent.
fn scans_arrive_in_time(config: &Config) -> Result<(), String> {
    let lidar = &config.devices.lidar;
    let needed_s = SPARE_TIME * lidar.longest_period_s();
    let timeout_s = config.safety.scan_timeout_s;
    if timeout_s >= needed_s {
        return Ok(());
    }
    Err(format!(
        "`scan_timeout_s = {timeout_s}` is too short for the {}, whose scans may come {:.3} s apart: the robot would stop between \
         two of them; set it to {:.2}. The robot drives slower with a slow scanner (`firmware-host check`)",
        lidar.name(),
        lidar.longest_period_s(),
        2.0 * lidar.longest_period_s()
    ))
}

/// The camera's frames must show a part of what perception works on.
fn frames_can_be_converted(config: &Config) -> Result<(), String> {
    let source = config.devices.camera_model()?;
    let format = config.devices.camera.format.pixels();
    FrontEnd::new(source, config.camera.model(), format, YuvRange::Limited)
        .map(drop)
        .map_err(|error| error.to_string())
}

fn refused<const N: usize>(results: [(&str, Result<(), String>); N]) -> Vec<Problem> {
    let refused =
        results.into_iter().filter_map(|(section, result)| Some((section, result.err()?)));
    refused
        .map(|(section, why)| Problem::Together { message: format!("[{section}]: {why}") })
        .collect()
}

#[cfg(feature = "simulator")]
fn nuisances(config: &Config) -> Result<(), String> {
    config.simulator.nuisances.check().map_err(|error| error.to_string())
}

#[cfg(not(feature = "simulator"))]
fn nuisances(_config: &Config) -> Result<(), String> {
    Ok(())
}

/// `firmware-host identity` prints key and name in one line of words.
fn name_is_a_word(config: &Config) -> Result<(), String> {
    let name = &config.identity.name;
    if name.contains(char::is_whitespace) {
        return Err(format!(
            "`name = {name:?}` has a space: give a name of one word, such as \"kitchen\""
        ));
    }
    Ok(())
}

fn body_is_finite(config: &Config) -> Result<(), String> {
    for sector in &config.safety.body {
        if ![sector.from_deg, sector.to_deg, sector.up_to_m].iter().all(|number| number.is_finite())
        {
            return Err(format!("`body` has a number that is not finite: {sector:?}"));
        }
    }
    Ok(())
}

fn back_off_ends_in_time(config: &Config) -> Result<(), String> {
    let safety = &config.safety;
    let speed_mps = config.base.speed_mps();
    let needed_s = safety.back_off_m / speed_mps;
    if needed_s <= safety.back_off_timeout_s {
        return Ok(());
    }
    Err(format!(
        "`back_off_m = {}` takes {needed_s:.1} s at {speed_mps:.2} m/s (`base.forward_step_m` per `base.tick_ms`), but \
         `back_off_timeout_s = {}` is less: increase the time or reduce the distance",
        safety.back_off_m, safety.back_off_timeout_s
    ))
}

/// The planner keeps a circle free of obstacles. Corners outside of that circle would hit what the robot passes.
fn corners_are_within_radius(config: &Config) -> Result<(), String> {
    let base = &config.base;
    if !base.footprint_m.is_empty() && base.footprint_m.len() < 3 {
        return Err(format!(
            "`footprint_m` has {} corners: give at least three, or none",
            base.footprint_m.len()
        ));
    }
    let farthest_m = base.footprint_m.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max);
    if farthest_m <= base.footprint_radius_m + 1e-9 {
        return Ok(());
    }
    Err(format!(
        "a corner of `footprint_m` is {farthest_m:.3} m away from the axle, outside of `footprint_radius_m = {}`: the \
         planner keeps only this circle free of obstacles; set the radius to {farthest_m:.3}",
        base.footprint_radius_m
    ))
}
