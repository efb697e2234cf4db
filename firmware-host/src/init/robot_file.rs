//! Writes the answers as a configuration: one line for each key, with a comment.
//!
//! Keys have their full names, without sections, so that the file stays below thirty lines whatever was answered.

use std::fmt::Write as _;
use std::path::Path;

use drivers::lidar::{LidarConfig, LidarKind};
use drivers::rplidar::RplidarConfig;
use drivers::v4l2::{CameraDeviceConfig, CameraFormat};
use toml::Value;

use super::answers::{Answer, Answers};
use super::endpoints::Endpoints;
use super::found::{Found, FrameOffer};
use super::questions::{Asked, QUESTIONS, Question, default_value, setting};
use super::turn_wheels::Correction;
use crate::config::{CameraSection, LensSection};

/// Comments begin in the same column, unless a value reaches further than this.
const WIDEST: usize = 44;

const TITLE: &str = "# By `firmware-host init`. `firmware-host check` prints the other keys; write them as here: section.key = value.";
/// In place of the title, so that the file stays below thirty lines.
const MEASURED: &str = "run.commissioning = \"measured\"  # `run` starts when `check --drive` has measured the robot. By `firmware-host init`; `check` prints the other keys.";
const KEPT: &str = "# From the file before:";

/// A key, its value as TOML, and its comment.
struct Line {
    key: &'static str,
    value: String,
    comment: String,
}

/// The text of the file. `before` is the file that it replaces, whose other keys it keeps.
pub fn text(
    answers: &Answers,
    found: &Found,
    correction: &Correction,
    before: Option<&toml::Table>,
) -> String {
    let answers = &with_order(answers, correction);
    let lines: Vec<Line> = QUESTIONS
        .iter()
        .filter(|question| answers.get(question.key).is_some())
        .flat_map(|question| lines_of(question, answers, found, correction))
        .chain(found.simulated.iter().flat_map(|folder| files_in(folder)))
        .collect();
    let first = commissioning(found, before);
    let assignments: Vec<String> =
        lines.iter().map(|line| format!("{} = {}", line.key, line.value)).collect();
    let lengths = assignments.iter().map(String::len);
    let width = lengths.filter(|length| *length <= WIDEST).max().unwrap_or(0);
    let mut text = format!("{}\n", first.unwrap_or(TITLE));
    for (line, assignment) in lines.iter().zip(&assignments) {
        // Writing into a string cannot fail.
        _ = writeln!(text, "{assignment:<width$}  # {}", line.comment);
    }
    let owned: Vec<&str> = lines.iter().map(|line| line.key).chain(keys_of_answers()).collect();
    let kept = before.map_or_else(Vec::new, |before| other_keys(before, &owned));
    if !kept.is_empty() {
        _ = write!(text, "\n{KEPT}\n{}\n", kept.join("\n"));
    }
    text
}

/// The answers, with the nodes in the order that was seen.
fn with_order(answers: &Answers, correction: &Correction) -> Answers {
    let mut answers = answers.clone();
    if correction.swap {
        let nodes = answers.numbers("nodes").iter().rev().copied().collect();
        answers.put("nodes", Answer::Numbers(nodes));
    }
    answers
}

fn lines_of(
    question: &Question,
    answers: &Answers,
    found: &Found,
    correction: &Correction,
) -> Vec<Line> {
    let mut lines = plain_lines(question, answers);
    match question.asked {
        Asked::FieldOfView => lines.extend(lens(answers, found)),
        Asked::Scanner => lines.extend(scanner(answers)),
        Asked::Endpoints => lines.extend(endpoints(answers)),
        Asked::Device(super::questions::Device::Camera) => lines.extend(frames(answers, found)),
        _ => {}
    }
    correct(question, &mut lines, correction);
    lines
}

/// The keys that hold the answer itself.
fn plain_lines(question: &Question, answers: &Answers) -> Vec<Line> {
    let with_value = question
        .sets
        .iter()
        .enumerate()
        .filter_map(|(place, sets)| Some((sets, value_at(question, answers, place)?)));
    with_value
        .filter(|(sets, value)| sets.always || default_value(sets.key) != Some(value))
        .map(|(sets, value)| Line {
            key: sets.key,
            value: value.to_string(),
            comment: sets.comment.to_owned(),
        })
        .collect()
}

fn value_at(question: &Question, answers: &Answers, place: usize) -> Option<Value> {
    match answers.get(question.key)? {
        Answer::Text(text) => Some(Value::String(text.clone())),
        Answer::Numbers(numbers) => {
            let number = numbers.get(place).or(numbers.last())?;
            Some(if question.is_whole(place) {
                Value::Integer(*number as i64)
            } else {
                Value::Float(*number)
            })
        }
    }
}

/// What the camera that was named offers.
fn offer<'a>(answers: &Answers, found: &'a Found) -> Option<&'a FrameOffer> {
    let device = answers.text("camera")?;
    let camera = found.cameras.iter().find(|camera| camera.device == device)?;
    camera.offer.as_ref().ok()
}

/// Size, format and rate of the frames, where they differ from the defaults.
fn frames(answers: &Answers, found: &Found) -> Vec<Line> {
    let Some(offer) = offer(answers, found) else { return Vec::new() };
    let default = CameraDeviceConfig::default();
    let mut lines = Vec::new();
    if (offer.width, offer.height) != (default.width, default.height) {
        lines.push(line("devices.camera.width", &offer.width, "Columns that the camera offers."));
        lines.push(line("devices.camera.height", &offer.height, "Rows that the camera offers."));
    }
    if let Some(format) = offer.format.filter(|format| *format != default.format) {
        lines.push(line("devices.camera.format", &format_name(format), "The camera has no other."));
    }
    let usual_fps = default.fps.unwrap_or(0.0);
    if let Some(fps) = offer.fps.filter(|fps| (fps - usual_fps).abs() > 0.01 * usual_fps) {
        let fps = format!("{:?}", rounded(fps, 100.0));
        lines.push(line("devices.camera.fps", &fps, "Frames a second that the camera offers."));
    }
    lines
}

fn format_name(format: CameraFormat) -> String {
    Value::try_from(format).map_or_else(|_| String::new(), |value| value.to_string())
}

/// A pinhole of the given field of view, where it differs from the default, and what perception sees of it.
fn lens(answers: &Answers, found: &Found) -> Vec<Line> {
    let default = CameraDeviceConfig::default();
    let size = offer(answers, found).map(|offer| (offer.width, offer.height));
    let (width, height) = size.unwrap_or((default.width, default.height));
    let fov_deg = answers.numbers("camera_fov_deg").first().copied().unwrap_or_default();
    let focal = rounded(f64::from(width) / 2.0 / (fov_deg / 2.0).to_radians().tan(), 10.0);
    let lens = LensSection {
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0 - 0.5,
        cy: f64::from(height) / 2.0 - 0.5,
        distortion: Vec::new(),
    };
    let mut lines = Vec::new();
    if lens != LensSection::default() {
        let LensSection { fx, fy, cx, cy, .. } = lens;
        let value = format!("{{ fx = {fx:?}, fy = {fy:?}, cx = {cx:?}, cy = {cy:?} }}");
        let comment = format!("{fov_deg} degrees wide; replace it by a calibration.");
        lines.push(line("devices.lens", &value, &comment));
    }
    if fov_deg < CameraSection::default().horizontal_fov_deg {
        let value = format!("{fov_deg:?}");
        lines.push(line(
            "camera.horizontal_fov_deg",
            &value,
            "Perception sees no more than the camera.",
        ));
    }
    lines
}

/// What the driver has to know of an ODrive's firmware.
fn endpoints(answers: &Answers) -> Vec<Line> {
    let Some(Ok(known)) = answers.text("odrive").map(Endpoints::parse) else { return Vec::new() };
    let Endpoints { firmware, enable_watchdog, watchdog_timeout } = known;
    let firmware = format!("{firmware:?}");
    vec![
        line("devices.base.odrive.firmware", &firmware, "Firmware of the ODrives."),
        line(
            "devices.base.odrive.enable_watchdog_endpoint",
            &enable_watchdog,
            "axis0.config.enable_watchdog in it; 0 is not known.",
        ),
        line(
            "devices.base.odrive.watchdog_timeout_endpoint",
            &watchdog_timeout,
            "axis0.config.watchdog_timeout in it; 0 is not known.",
        ),
    ]
}

/// Kind and model of the scanner, and a time-out that is long enough for it.
fn scanner(answers: &Answers) -> Vec<Line> {
    let name = answers.text("lidar").unwrap_or_default();
    let is = "What the safety LiDAR is.";
    match (name, name.strip_prefix("rplidar-")) {
        (_, Some(model)) => {
            let mut lines = vec![line("devices.lidar.kind", &quoted("rplidar"), is)];
            lines.push(line("devices.lidar.rplidar.model", &quoted(model), "Its model."));
            lines.extend(time_out(model));
            lines
        }
        ("ld06", _) => vec![line("devices.lidar.kind", &quoted("ld06"), is)],
        _ => vec![line("devices.lidar.model", &quoted(name), is)],
    }
}

fn quoted(value: &str) -> String {
    Value::String(value.to_owned()).to_string()
}

/// A slow RPLIDAR needs a longer time-out than the default.
fn time_out(model: &str) -> Option<Line> {
    let model = Value::String(model.to_owned()).try_into().ok()?;
    let rplidar = RplidarConfig { model, ..RplidarConfig::default() };
    let lidar = LidarConfig { kind: LidarKind::Rplidar, rplidar, ..LidarConfig::default() };
    let needed_s = 2.0 * lidar.longest_period_s();
    let default_s = default_value("safety.scan_timeout_s").and_then(Value::as_float)?;
    let value = format!("{:?}", rounded(needed_s, 100.0));
    (needed_s > 1.25 * default_s)
        .then(|| line("safety.scan_timeout_s", &value, "Two revolutions of this scanner, s."))
}

/// The first line for a real robot, which drives only with numbers that were measured, unless the file before says otherwise. A
/// simulated one is exempt: `check --drive` takes longer than trying `run`, and nothing can be hit.
fn commissioning(found: &Found, before: Option<&toml::Table>) -> Option<&'static str> {
    let is_kept = before.and_then(|file| file.get("run")?.get("commissioning")).is_some();
    (found.simulated.is_none() && !is_kept).then_some(MEASURED)
}

/// The files of a simulated robot: not every account may write those of a real one.
fn files_in(folder: &Path) -> [Line; 3] {
    [
        line("run.status_file", &path_in(folder, "status.json"), "Read by `health`."),
        line(
            "run.task_file",
            &path_in(folder, "task.json"),
            "Written by `go-to`, `return` and `resume`.",
        ),
        line(
            "run.stop_file",
            &path_in(folder, "last_stop.json"),
            "Remembers a stop that needs a person.",
        ),
    ]
}

fn path_in(folder: &Path, name: &str) -> Value {
    Value::String(folder.join(name).display().to_string())
}

fn line(key: &'static str, value: &impl ToString, comment: &str) -> Line {
    Line { key, value: value.to_string(), comment: comment.to_owned() }
}

fn rounded(number: f64, parts: f64) -> f64 {
    (number * parts).round() / parts
}

/// Puts what turning the wheels showed into the lines of a question.
fn correct(question: &Question, lines: &mut Vec<Line>, correction: &Correction) {
    match question.key {
        "nodes" => {
            let seen = "The wheel rotated backwards when it was commanded forward.";
            let keys = ["devices.base.invert_left", "devices.base.invert_right"];
            for (key, _) in keys.into_iter().zip(correction.invert).filter(|(_, invert)| *invert) {
                lines.push(line(key, &true, seen));
            }
        }
        "gear_ratio" => {
            if let Some((gear_ratio, line)) = correction.gear_ratio.zip(lines.first_mut()) {
                line.value = format!("{gear_ratio:?}");
                line.comment =
                    "Turns of the motor in one of the wheel, by eye: check the gearbox.".to_owned();
            }
        }
        _ => {}
    }
}

/// The keys that answers decide about, whether a file names them or leaves them at their defaults.
fn keys_of_answers() -> impl Iterator<Item = &'static str> {
    let asked = QUESTIONS.iter().flat_map(|question| question.sets).map(|sets| sets.key);
    let derived = [
        "devices.camera.width",
        "devices.camera.height",
        "devices.camera.format",
        "devices.camera.fps",
        "devices.lens",
        "camera.horizontal_fov_deg",
        "devices.lidar.kind",
        "devices.lidar.model",
        "devices.lidar.rplidar.model",
        "safety.scan_timeout_s",
        "devices.base.swap_wheels",
        "devices.base.invert_left",
        "devices.base.invert_right",
        "devices.base.odrive.firmware",
        "devices.base.odrive.enable_watchdog_endpoint",
        "devices.base.odrive.watchdog_timeout_endpoint",
    ];
    asked.chain(derived)
}

/// The assignments of a file whose keys are not owned, with full names. A key that this version does not know is left out.
fn other_keys(before: &toml::Table, owned: &[&str]) -> Vec<String> {
    let mut kept = Vec::new();
    collect("", before, owned, &mut kept);
    kept
}

fn collect(prefix: &str, table: &toml::Table, owned: &[&str], kept: &mut Vec<String>) {
    for (name, value) in table {
        let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        if owned.contains(&path.as_str()) || setting(&path).is_none() {
            continue;
        }
        match value {
            Value::Table(inner) => collect(&path, inner, owned, kept),
            value => kept.push(format!("{path} = {value}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Commissioning, Config};
    use crate::init::found::FoundCamera;
    use crate::init::questions::scanners;

    /// The most lines of a new file.
    const MOST_LINES: usize = 30;

    fn defaults_with(changes: &[(&'static str, Answer)], found: &Found) -> Answers {
        let mut answers = Answers::default();
        for question in QUESTIONS {
            let given = changes.iter().find(|(key, _)| *key == question.key);
            let answer = given.map_or_else(|| question.default(found, &answers), |it| it.1.clone());
            if question.applies(&answers) {
                answers.put(question.key, answer);
            }
        }
        answers
    }

    fn words(text: &str) -> Answer {
        Answer::Text(text.to_owned())
    }

    /// A camera of which nothing is as in the defaults.
    fn odd_camera() -> Found {
        let offer = FrameOffer {
            formats: vec!["MJPG".to_owned()],
            format: Some(CameraFormat::Mjpeg),
            width: 1280,
            height: 720,
            fps: Some(25.0),
        };
        let camera =
            FoundCamera { device: "/dev/video0".to_owned(), name: String::new(), offer: Ok(offer) };
        Found { cameras: vec![camera], ..Found::default() }
    }

    fn parsed(text: &str) -> Config {
        Config::parse(text, Path::new("robot.toml")).unwrap()
    }

    #[test]
    fn the_file_is_valid_and_at_most_thirty_lines_long_with_a_comment_each_whatever_was_answered() {
        let found = odd_camera();
        let correction = Correction { swap: true, invert: [true; 2], gear_ratio: Some(9.7) };
        for scanner in scanners() {
            for protocol in ["odrive", "vesc", "cia402"] {
                let answers = defaults_with(
                    &[
                        ("lidar", words(&scanner)),
                        ("protocol", words(protocol)),
                        ("bus", words("can3")),
                        ("camera_fov_deg", Answer::Numbers(vec![60.0])),
                        ("nodes", Answer::Numbers(vec![11.0, 12.0])),
                        ("odrive", words("0.5.6 195 196")),
                        ("pole_pairs", Answer::Numbers(vec![15.0])),
                        ("counts_per_turn", Answer::Numbers(vec![10000.0])),
                    ],
                    &found,
                );
                let text = text(&answers, &found, &correction, None);
                assert!(text.lines().count() <= MOST_LINES, "{text}");
                assert!(
                    text.lines()
                        .all(|line| line.contains("# ") && line.ends_with('.')
                            || line.starts_with('#')),
                    "{text}"
                );
                parsed(&text).check_devices(Path::new("robot.toml")).unwrap();
            }
        }
    }

    #[test]
    fn every_answer_reaches_the_configuration() {
        let found = odd_camera();
        let answers = defaults_with(
            &[
                ("camera_place_m", Answer::Numbers(vec![0.3, -0.1])),
                ("camera_fov_deg", Answer::Numbers(vec![60.0])),
                ("lidar_port", words("/dev/ttyUSB7")),
                ("lidar", words("rplidar-a1")),
                ("lidar_zero_deg", Answer::Numbers(vec![180.0])),
                ("protocol", words("cia402")),
                ("counts_per_turn", Answer::Numbers(vec![8192.0])),
                ("nodes", Answer::Numbers(vec![5.0, 6.0])),
                ("wheels_m", Answer::Numbers(vec![0.08, 0.31])),
                ("gear_ratio", Answer::Numbers(vec![20.0])),
                ("footprint_radius_m", Answer::Numbers(vec![0.25])),
            ],
            &found,
        );
        let config = parsed(&text(&answers, &found, &Correction::default(), None));
        assert_eq!((config.camera.height_m, config.camera.forward_m), (0.3, -0.1));
        assert_eq!(config.camera.horizontal_fov_deg, 60.0);
        let camera = &config.devices.camera;
        assert_eq!((camera.width, camera.height, camera.fps), (1280, 720, Some(25.0)));
        assert_eq!(camera.format, CameraFormat::Mjpeg);
        let lens = &config.devices.lens;
        assert_eq!((lens.fx, lens.cx, lens.cy), (1108.5, 639.5, 359.5));
        let lidar = &config.devices.lidar;
        assert_eq!((lidar.port.to_string().as_str(), lidar.zero_deg), ("/dev/ttyUSB7", 180.0));
        assert_eq!((lidar.kind, lidar.name().as_str()), (LidarKind::Rplidar, "RPLIDAR A1"));
        assert_eq!(config.safety.scan_timeout_s, 0.42);
        let base = &config.devices.base;
        assert_eq!((base.left_node, base.right_node, base.gear_ratio), (5, 6, 20.0));
        assert_eq!((base.wheel_radius_m, base.track_m), (0.08, 0.31));
        assert_eq!((base.cia402.position_units, base.cia402.velocity_units), (8192.0, 8192.0));
        assert_eq!(config.base.footprint_radius_m, 0.25);
    }

    #[test]
    fn a_real_robot_is_to_be_measured_before_it_drives_unless_the_file_before_says_otherwise() {
        let real = Found::default();
        let simulated = Found { simulated: Some("/tmp/robot".into()), ..Found::default() };
        let before: toml::Table = "[run]\ncommissioning = \"by_hand\"".parse().unwrap();
        assert_eq!(written_commissioning(&real, None), Commissioning::Measured);
        assert_eq!(
            written_commissioning(&real, Some(&toml::Table::new())),
            Commissioning::Measured
        );
        assert_eq!(written_commissioning(&real, Some(&before)), Commissioning::ByHand);
        assert_eq!(written_commissioning(&simulated, None), Commissioning::Unchecked);
    }

    fn written_commissioning(found: &Found, before: Option<&toml::Table>) -> Commissioning {
        let answers = defaults_with(&[], found);
        parsed(&text(&answers, found, &Correction::default(), before)).run.commissioning
    }

    #[test]
    fn a_replaced_file_keeps_the_keys_that_are_not_asked_for() {
        let before: toml::Table =
            "[run]\narm_at_start = false\n[camera]\nheight_m = 2.0\nwidth = 320\n\
             [devices.base]\nleft_node = 9\ninvert_left = true\nwatchdog_ms = 50\n[old]\nkey = 1"
                .parse()
                .unwrap();
        let found = Found::default();
        let answers = defaults_with(&[], &found);
        let text = text(&answers, &found, &Correction::default(), Some(&before));
        let config = parsed(&text);
        assert!(!config.run.arm_at_start && config.camera.width == 320, "{text}");
        assert_eq!(config.devices.base.watchdog_ms, 50);
        let base = &config.devices.base;
        assert!(
            base.left_node == 1 && !base.invert_left && config.camera.height_m == 0.8,
            "{text}"
        );
    }
}
