//! Compares a user's file, key by key, with the keys that exist and the ranges that are allowed.

use drivers::v4l2::Setting;
use toml::de::{DeTable, DeValue};

use super::{Config, Problem, limits};

/// How alike two names must be, by Damerau-Levenshtein from 0 to 1, to be taken for a typing error.
const ALIKE: f64 = 0.6;

/// Unknown keys and values out of range, in the order of the file.
pub(super) fn file(document: &DeTable<'_>, text: &str) -> Vec<Problem> {
    let known = toml::Table::try_from(with_every_key()).unwrap_or_default();
    let mut found = Vec::new();
    table(document, &known, "", &known, &mut found);
    found.sort_by_key(|(offset, _)| *offset);
    found.into_iter().map(|(offset, problem)| with_line(problem, line_of(text, offset))).collect()
}

/// The default configuration and, of what is left alone by default, something.
fn with_every_key() -> Config {
    let mut config = Config::default();
    let camera = &mut config.devices.camera;
    (camera.exposure_us, camera.gain, camera.white_balance_k) =
        (Some(Setting::Auto), Some(Setting::Auto), Some(Setting::Auto));
    config
}

fn table(
    given: &DeTable<'_>,
    known: &toml::Table,
    prefix: &str,
    root: &toml::Table,
    found: &mut Vec<(usize, Problem)>,
) {
    for (name, value) in given {
        let key = join(prefix, name.get_ref());
        let offset = name.span().start;
        match (known.get(name.get_ref().as_ref()), value.get_ref()) {
            (None, _) => {
                let advice = advice(name.get_ref(), prefix, known, root);
                found.push((offset, Problem::UnknownKey { line: 0, key, advice }));
            }
            (Some(toml::Value::Table(known)), DeValue::Table(given)) => {
                table(given, known, &key, root, found);
            }
            (Some(known), value) => {
                found.extend(impossible(&key, value, known).map(|problem| (offset, problem)));
            }
        }
    }
}

fn impossible(key: &str, value: &DeValue<'_>, known: &toml::Value) -> Option<Problem> {
    let limit = limits::of(key);
    // A whole number is also a number; of a list, every element must be possible.
    let fits = match (value, known) {
        (DeValue::Integer(_), toml::Value::Float(_)) => true,
        // A camera's setting is "auto" or a number.
        (DeValue::Integer(_), toml::Value::String(known)) if known == "auto" => true,
        (DeValue::Array(elements), toml::Value::Array(known)) => {
            let element = known.first();
            elements.iter().all(|given| match element {
                Some(element) => impossible(key, given.get_ref(), element).is_none(),
                None => limit.is_none_or(|limit| all_allowed(given.get_ref(), limit)),
            })
        }
        _ => value.type_str() == known.type_str(),
    };
    let in_range = match (number(value), limit) {
        (Some(number), Some(limit)) => limit.allows(number),
        _ => true,
    };
    let problem = || Problem::Impossible {
        line: 0,
        key: key.into(),
        value: written(value),
        allowed: allowed(known, limit),
    };
    (!(fits && in_range)).then(problem)
}

/// Of a list, or a list of lists, whose default is empty.
fn all_allowed(value: &DeValue<'_>, limit: &limits::Limit) -> bool {
    match value {
        DeValue::Array(elements) => {
            elements.iter().all(|element| all_allowed(element.get_ref(), limit))
        }
        value => number(value).is_some_and(|number| limit.allows(number)),
    }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        // A number that no integer type holds is in no range.
        DeValue::Integer(integer) => Some(
            i128::from_str_radix(integer.as_str(), integer.radix())
                .map_or(f64::NAN, |number| number as f64),
        ),
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

fn written(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Integer(integer) => integer.as_str().to_owned(),
        DeValue::Float(float) => float.as_str().to_owned(),
        DeValue::String(text) => format!("\"{text}\""),
        DeValue::Boolean(yes) => yes.to_string(),
        DeValue::Datetime(time) => time.to_string(),
        DeValue::Array(elements) => {
            format!(
                "[{}]",
                elements
                    .iter()
                    .map(|element| written(element.get_ref()))
                    .collect::<Vec<_>>()
                    .join(", ")
            )
        }
        DeValue::Table(_) => "{...}".to_owned(),
    }
}

fn allowed(known: &toml::Value, limit: Option<&limits::Limit>) -> String {
    match (limit, known) {
        (Some(limit), toml::Value::Integer(_)) => format!("a whole number, {limit}"),
        (Some(limit), toml::Value::Array(_)) => format!("a list of {limit}"),
        (Some(limit), _) => limit.to_string(),
        (None, toml::Value::Boolean(_)) => "true or false".to_owned(),
        (None, known) => format!("a {}", known.type_str()),
    }
}

/// A similar key of the same table; else the same or a similar name elsewhere; else all keys of the table.
fn advice(name: &str, prefix: &str, siblings: &toml::Table, root: &toml::Table) -> String {
    if let Some(similar) = most_alike(name, siblings.keys().map(|key| (key.as_str(), key.clone())))
    {
        return format!("did you mean `{similar}`?");
    }
    let mut everywhere = Vec::new();
    leaves(root, "", &mut everywhere);
    let by_leaf =
        everywhere.iter().map(|full| (full.rsplit('.').next().unwrap_or(full), full.clone()));
    if let Some(similar) = most_alike(name, by_leaf) {
        return format!("did you mean `{similar}`?");
    }
    let place = if prefix.is_empty() {
        "the sections are".to_owned()
    } else {
        format!("the keys of `{prefix}` are")
    };
    let names: Vec<String> = siblings.keys().map(|key| format!("`{key}`")).collect();
    format!("{place} {}", names.join(", "))
}

fn most_alike<'a>(
    name: &str,
    candidates: impl Iterator<Item = (&'a str, String)>,
) -> Option<String> {
    candidates
        .map(|(candidate, answer)| {
            (strsim::normalized_damerau_levenshtein(name, candidate), answer)
        })
        .filter(|(score, _)| *score >= ALIKE)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, answer)| answer)
}

/// Full dotted names of all keys below `table` that hold a value.
pub(super) fn leaves(table: &toml::Table, prefix: &str, into: &mut Vec<String>) {
    for (name, value) in table {
        let key = join(prefix, name);
        match value {
            toml::Value::Table(inner) => leaves(inner, &key, into),
            _ => into.push(key),
        }
    }
}

fn join(prefix: &str, name: &str) -> String {
    if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
}

fn with_line(problem: Problem, at: usize) -> Problem {
    match problem {
        Problem::UnknownKey { key, advice, .. } => Problem::UnknownKey { line: at, key, advice },
        Problem::Impossible { key, value, allowed, .. } => {
            Problem::Impossible { line: at, key, value, allowed }
        }
        together @ Problem::Together { .. } => together,
    }
}

/// Values that are possible one by one, but not together: what each part of the runtime says of its own, and what no
/// part can see alone.
pub(super) fn together(config: &Config) -> Vec<Problem> {
    let parts = [
        ("coarse", config.coarse.validate().map_err(|error| error.to_string())),
        ("map", config.map.validate().map_err(|error| error.to_string())),
        ("planning", config.plan_config().validate().map_err(|error| error.to_string())),
        ("planning", config.follower_config().validate().map_err(|error| error.to_string())),
        (
            "simulator.nuisances",
            config.simulator.nuisances.check().map_err(|error| error.to_string()),
        ),
        ("safety", back_off_in_time(config)),
        ("base", corners_within_radius(config)),
    ];
    let refused = parts.into_iter().filter_map(|(section, result)| Some((section, result.err()?)));
    refused
        .map(|(section, why)| Problem::Together { message: format!("[{section}]: {why}") })
        .collect()
}

/// What the drivers refuse: a simulated robot has none, so only `run` and `check` ask.
pub(super) fn devices(config: &Config) -> Vec<Problem> {
    let devices = &config.devices;
    let parts = [
        ("devices.camera", devices.camera.check().map_err(|error| error.to_string())),
        ("devices.lens", devices.camera_model().map(|_| ())),
        ("devices.lidar", devices.lidar.validate().map_err(|error| error.to_string())),
        ("devices.base", devices.base.validate().map_err(|error| error.to_string())),
    ];
    let refused = parts.into_iter().filter_map(|(section, result)| Some((section, result.err()?)));
    refused
        .map(|(section, why)| Problem::Together { message: format!("[{section}]: {why}") })
        .collect()
}

fn back_off_in_time(config: &Config) -> Result<(), String> {
    let (safety, speed_mps) = (&config.safety, config.base.speed_mps());
    let needed_s = safety.back_off_m / speed_mps;
    if needed_s <= safety.back_off_timeout_s {
        return Ok(());
    }
    Err(format!(
        "`back_off_m = {}` takes {needed_s:.1} s at `base.forward_step_m` every `base.tick_ms` ({speed_mps:.2} m/s), but \
         `back_off_timeout_s = {}` ends it earlier: allow more time or less distance",
        safety.back_off_m, safety.back_off_timeout_s
    ))
}

/// The planner keeps a circle clear; corners outside of it would meet what it passes.
fn corners_within_radius(config: &Config) -> Result<(), String> {
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
        "a corner of `footprint_m` lies {farthest_m:.3} m from the axle, outside of `footprint_radius_m = {}`: the planner \
         keeps that circle clear, so make it {farthest_m:.3}",
        base.footprint_radius_m
    ))
}
