//! Answers: as a person types them, and as a file holds them.

use std::collections::BTreeMap;
use std::fmt;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail};
use drivers::Port;
use drivers::can::{BaseConfig, Protocol};
use strsim::normalized_damerau_levenshtein;

use super::endpoints::Endpoints;
use super::found::Found;
use super::questions::{Asked, Device, QUESTIONS, Question};

/// Similarity (Damerau-Levenshtein, 0 to 1) from which an unknown name counts as a typing error of a known one.
const SIMILAR: f64 = 0.6;

/// The answer to one question.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// A device or a choice.
    Text(String),
    /// Numbers, in the order of the question's keys.
    Numbers(Vec<f64>),
}

impl fmt::Display for Answer {
    /// As a person types it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Numbers(numbers) => {
                let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
                f.write_str(&words.join(" "))
            }
        }
    }
}

/// All answers, by the keys of their questions.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Answers(BTreeMap<&'static str, Answer>);

impl Answers {
    /// Remembers an answer.
    pub fn put(&mut self, key: &'static str, answer: Answer) {
        self.0.insert(key, answer);
    }

    /// The answer to a question that was asked.
    pub fn get(&self, key: &str) -> Option<&Answer> {
        self.0.get(key)
    }

    /// The device or choice that was named.
    pub fn text(&self, key: &str) -> Option<&str> {
        match self.get(key)? {
            Answer::Text(text) => Some(text),
            Answer::Numbers(_) => None,
        }
    }

    /// The numbers that were given; none if the question was not asked.
    pub fn numbers(&self, key: &str) -> &[f64] {
        match self.get(key) {
            Some(Answer::Numbers(numbers)) => numbers,
            _ => &[],
        }
    }
}

/// What a person typed, as an answer. The error says what is wrong and what is allowed.
pub fn typed(
    question: &Question,
    text: &str,
    found: &Found,
    answers: &Answers,
) -> Result<Answer, String> {
    match question.asked {
        Asked::Numbers(_) | Asked::FieldOfView => {
            let numbers: Result<Vec<f64>, String> = text.split_whitespace().map(number).collect();
            checked(question, Answer::Numbers(numbers?), found, answers)
        }
        Asked::Endpoints => checked(question, Answer::Text(text.to_owned()), found, answers),
        Asked::Device(_) | Asked::Choice | Asked::Scanner => {
            let options = question.options(found);
            let chosen = text.parse::<usize>().ok();
            let answer = match chosen {
                None => text.to_owned(),
                Some(number) => number
                    .checked_sub(1)
                    .and_then(|place| options.get(place))
                    .ok_or_else(|| no_such_option(number, options.len()))?
                    .clone(),
            };
            checked(question, Answer::Text(answer), found, answers)
        }
    }
}

fn no_such_option(number: usize, options: usize) -> String {
    match options {
        0 => format!("there is no list to choose number {number} from: give its name"),
        1 => format!("there is no number {number}: give 1, or a name"),
        _ => format!("there is no number {number}: give one of 1 to {options}, or a name"),
    }
}

fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| {
        let hint = if word.contains(',') {
            ": write decimals with a point, and a space between two numbers"
        } else {
            ""
        };
        format!("`{word}` is not a number{hint}")
    })
}

/// The answer, if it is allowed.
fn checked(
    question: &Question,
    answer: Answer,
    found: &Found,
    answers: &Answers,
) -> Result<Answer, String> {
    match (question.asked, &answer) {
        (Asked::Numbers(_) | Asked::FieldOfView, Answer::Numbers(numbers)) => {
            check_numbers(question, numbers)?;
            if question.key == "nodes" {
                check_nodes(numbers, answers)?;
            }
        }
        (Asked::Device(device), Answer::Text(name)) => check_device(device, name)?,
        (Asked::Endpoints, Answer::Text(text)) => drop(Endpoints::parse(text)?),
        (Asked::Choice | Asked::Scanner, Answer::Text(name)) => {
            let options = question.options(found);
            if !options.contains(name) {
                return Err(format!("`{name}` is not one of {}", options.join(", ")));
            }
        }
        (Asked::Numbers(_) | Asked::FieldOfView, Answer::Text(text)) => {
            return Err(format!("`{text}` is a text, and numbers are wanted"));
        }
        (_, Answer::Numbers(_)) => {
            return Err(format!("`{answer}` is a number, and a text is wanted"));
        }
    }
    Ok(answer)
}

fn check_numbers(question: &Question, numbers: &[f64]) -> Result<(), String> {
    let ranges = question.ranges();
    if numbers.len() != ranges.len() {
        let wanted = if ranges.len() == 1 { "one number is" } else { "two numbers are" };
        return Err(format!("{wanted} wanted, and {} given", numbers.len()));
    }
    for (place, (number, range)) in numbers.iter().zip(ranges).enumerate() {
        let Some(range) = range else { continue };
        if !range.allows(*number) {
            return Err(format!("{number} is not allowed: it must be {}", range.text));
        }
        if question.is_whole(place) && number.fract() != 0.0 {
            return Err(format!("{number} is not a whole number"));
        }
    }
    Ok(())
}

/// Nodes that the protocol allows, and two of them.
fn check_nodes(numbers: &[f64], answers: &Answers) -> Result<(), String> {
    let protocol = answers.text("protocol").unwrap_or_default().to_owned();
    let protocol: Protocol = toml::Value::String(protocol).try_into().unwrap_or(Protocol::Odrive);
    let mut base = BaseConfig { protocol, ..BaseConfig::default() };
    // Only the nodes are judged here.
    base.odrive.enable_watchdog_endpoint = 1;
    base.odrive.watchdog_timeout_endpoint = 1;
    // The range of the keys is within a byte.
    base.left_node = numbers.first().map_or(0, |node| *node as u8);
    base.right_node = numbers.last().map_or(0, |node| *node as u8);
    base.validate().map_err(|error| error.to_string())
}

fn check_device(device: Device, name: &str) -> Result<(), String> {
    let example = match device {
        Device::Port => return name.parse::<Port>().map(drop).map_err(|error| error.to_string()),
        Device::Camera if name.starts_with('/') || name.starts_with("unix:/") => return Ok(()),
        Device::Bus if !name.is_empty() && !name.contains(char::is_whitespace) => return Ok(()),
        Device::Camera => "a path such as /dev/video0, or unix:/path",
        Device::Bus => "an interface such as can0, or unix:/path",
    };
    Err(format!("`{name}` is not allowed: it must be {example}"))
}

/// The answers in a file, and defaults for the others.
///
/// # Errors
/// The file cannot be read, or an answer is not allowed: all of them are named.
pub fn read(path: &Path, found: &Found) -> Result<Answers> {
    let text = std::fs::read_to_string(path).with_context(|| {
        format!(
            "cannot read the answers {}; `firmware-host init --print-answers > answers.toml` writes some to begin with",
            path.display()
        )
    })?;
    parse(&text, found).with_context(|| path.display().to_string())
}

fn parse(text: &str, found: &Found) -> Result<Answers> {
    let table: toml::Table = text.parse()?;
    let mut problems: Vec<String> = table.keys().filter_map(|key| unknown(key)).collect();
    let mut answers = Answers::default();
    // A question comes after the one that it depends on.
    for question in QUESTIONS {
        if question.applies(&answers) {
            take(question, &table, found, &mut answers, &mut problems);
        }
    }
    if !problems.is_empty() {
        bail!("{}", problems.join("\n"));
    }
    Ok(answers)
}

fn take(
    question: &Question,
    table: &toml::Table,
    found: &Found,
    answers: &mut Answers,
    problems: &mut Vec<String>,
) {
    let Some(value) = table.get(question.key) else {
        answers.put(question.key, question.default(found, answers));
        return;
    };
    let answer = from_toml(value).and_then(|answer| checked(question, answer, found, answers));
    match answer {
        Ok(answer) => answers.put(question.key, answer),
        Err(why) => problems.push(format!("`{} = {value}`: {why}", question.key)),
    }
}

fn from_toml(value: &toml::Value) -> Result<Answer, String> {
    match value {
        toml::Value::String(text) => Ok(Answer::Text(text.clone())),
        toml::Value::Array(list) => {
            let numbers: Result<Vec<f64>, String> = list.iter().map(number_of).collect();
            numbers.map(Answer::Numbers)
        }
        one => number_of(one).map(|number| Answer::Numbers(vec![number])),
    }
}

fn number_of(value: &toml::Value) -> Result<f64, String> {
    let integer = value.as_integer().map(|number| number as f64);
    value.as_float().or(integer).ok_or_else(|| format!("{value} is not a number"))
}

fn unknown(key: &str) -> Option<String> {
    let names: Vec<&str> = QUESTIONS.iter().map(|question| question.key).collect();
    if names.contains(&key) {
        return None;
    }
    let similar = names.iter().map(|name| (*name, normalized_damerau_levenshtein(key, name)));
    let nearest = similar.max_by(|(_, a), (_, b)| a.total_cmp(b));
    let nearest = nearest.filter(|(_, similarity)| *similarity >= SIMILAR);
    Some(match nearest {
        Some((name, _)) => format!("there is no question `{key}`: did you mean `{name}`?"),
        None => format!("there is no question `{key}`: they are {}", names.join(", ")),
    })
}

/// A file of answers that holds every question with its default.
pub fn template(found: &Found) -> String {
    let mut answers = Answers::default();
    for question in QUESTIONS {
        answers.put(question.key, question.default(found, &answers));
    }
    let mut text = "# Answers for `firmware-host init --answers FILE`. A question that is left out has its default.\n".to_owned();
    for question in QUESTIONS {
        // Writing into a string cannot fail.
        _ = write!(text, "\n{}", entry(question, found, &answers));
    }
    text
}

fn entry(question: &Question, found: &Found, answers: &Answers) -> String {
    let mut text = format!("# {}\n", question.words);
    if let Some((key, values)) = question.only_with {
        _ = writeln!(text, "# Only with {key} = {}.", values.join(", "));
    }
    if let Some(allowed) = question.allowed() {
        _ = writeln!(text, "# {allowed}");
    }
    let options = question.options(found);
    if !options.is_empty() {
        _ = writeln!(text, "# {}", options.join(", "));
    }
    if !question.help.is_empty() {
        _ = writeln!(text, "# {}", question.help);
    }
    let value = match answers.get(question.key) {
        Some(Answer::Numbers(numbers)) => {
            let words: Vec<String> = numbers.iter().map(ToString::to_string).collect();
            let list = words.join(", ");
            if words.len() == 1 { list } else { format!("[{list}]") }
        }
        Some(Answer::Text(text)) => toml::Value::String(text.clone()).to_string(),
        None => return text,
    };
    text + &format!("{} = {value}\n", question.key)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn question(key: &str) -> &'static Question {
        QUESTIONS.iter().find(|question| question.key == key).unwrap()
    }

    fn refusal(key: &str, text: &str) -> String {
        typed(question(key), text, &Found::default(), &Answers::default()).unwrap_err()
    }

    #[test]
    fn an_answer_out_of_range_is_refused_with_the_range_and_nan_is_out_of_every_range() {
        assert!(
            refusal("camera_place_m", "9 0").contains("9 is not allowed: it must be 0.05 to 3.0 m")
        );
        assert!(refusal("gear_ratio", "NaN").contains("NaN is not allowed: it must be 0.01 to"));
        assert!(refusal("gear_ratio", "inf").contains("inf is not allowed"));
        assert!(refusal("camera_fov_deg", "5").contains("20.0 to 150.0 degrees"));
    }

    #[test]
    fn what_is_no_number_or_too_many_of_them_is_explained() {
        assert!(refusal("wheels_m", "0,05 0,24").contains("decimals with a point"));
        assert!(refusal("wheels_m", "0.05").contains("two numbers are wanted, and 1 given"));
        assert!(refusal("gear_ratio", "1 2").contains("one number is wanted"));
        assert!(refusal("gear_ratio", "ten").contains("`ten` is not a number"));
        assert!(refusal("nodes", "1.5 2").contains("not a whole number"));
        assert!(refusal("nodes", "1 1").contains("another node than left_node"));
        assert!(refusal("nodes", "1 63").contains("0 to 62"));
    }

    #[test]
    fn a_choice_is_made_by_number_or_name_and_another_is_refused_with_the_names() {
        let given =
            |text| typed(question("lidar"), text, &Found::default(), &Answers::default()).unwrap();
        assert_eq!(given("9"), given("ld06"));
        assert!(refusal("lidar", "10").contains("one of 1 to 9"));
        assert!(refusal("lidar", "utm").contains("`utm` is not one of urg-04lx, utm-30lx"));
        assert!(refusal("camera", "2").contains("no list to choose number 2 from"));
        assert!(refusal("camera", "video0").contains("a path such as /dev/video0"));
        assert!(refusal("lidar_port", "ttyUSB0").contains("/dev/serial/by-id"));
        assert!(refusal("bus", "").contains("can0"));
        assert!(refusal("odrive", "195 196").contains("such as 0.6.10 195 196"));
    }

    #[test]
    fn the_template_is_a_file_of_answers_that_gives_every_question_its_default() {
        let found = Found::default();
        let answers = parse(&template(&found), &found).unwrap();
        assert_eq!(answers, parse("", &found).unwrap());
    }

    #[test]
    fn every_wrong_answer_of_a_file_is_named_with_the_way_out() {
        let text = "camra = \"/dev/video0\"\nlidar = 3\nwheels_m = [0.05, nan]\nnodes = [1, true]";
        let error = format!("{:#}", parse(text, &Found::default()).unwrap_err());
        for part in [
            "`camra`: did you mean `camera`?",
            "`lidar = 3`: `3` is a number, and a text is wanted",
            "NaN is not allowed: it must be 0.03 to 3.0 m",
            "true is not a number",
        ] {
            assert!(error.contains(part), "{part} in {error}");
        }
    }
}
