//! What a robot's program says as JSON: `model list --json` and `model install --json`.

use serde::Deserialize;

/// Longest text of a robot that is kept, in characters. The longest reasons of the gate have a few hundred.
const MAX_TEXT_LEN: usize = 1000;

/// What happened to a model, in the words of the robot's history.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    Installed,
    Refused,
    Kept,
    RolledBack,
    /// A word that a newer program writes.
    #[serde(other)]
    Other,
}

/// One entry of the robot's history about the model of the rollout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    pub what: What,
    pub why: String,
}

/// What `model list` says about the model of the rollout.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Listed {
    /// Whether the robot uses the model, and whether it is on trial.
    pub current: Option<Trial>,
    /// The robot's history of the model, oldest first.
    pub events: Vec<Event>,
    /// The model that the robot uses, for people.
    pub runs: String,
}

/// Whether the model that a robot uses is on trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trial {
    Runs,
    Ended,
}

/// What `model install` says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Judged {
    Accepted,
    /// The robot uses the model already.
    Current,
    Refused {
        why: String,
    },
}

#[derive(Deserialize)]
struct ListJson {
    state: Option<StateJson>,
    problem: Option<String>,
    #[serde(default)]
    history: Vec<EntryJson>,
}

#[derive(Deserialize)]
struct StateJson {
    models: Vec<String>,
    trial_starts: Option<u64>,
}

#[derive(Deserialize)]
struct EntryJson {
    what: What,
    digest: String,
    #[serde(default)]
    name: String,
    #[serde(default)]
    why: String,
}

#[derive(Deserialize)]
struct InstallJson {
    accepted: bool,
    #[serde(default)]
    kind: String,
    #[serde(default)]
    why: String,
}

/// The JSON object in a program's output: the last line that begins with `{`. Others may be greetings of the robot's shell.
fn object(output: &str) -> Option<&str> {
    output.lines().rev().find(|line| line.starts_with('{'))
}

/// Reads the output of `model list --json`; `None` if it is no list.
///
/// # Errors
/// With the robot's words, when its store is damaged.
pub fn read_list(output: &str, digest: &str) -> Option<Result<Listed, String>> {
    let list: ListJson = serde_json::from_str(object(output)?).ok()?;
    let Some(state) = list.state else {
        return Some(Err(clean(&list.problem.unwrap_or_else(|| "no state".to_owned()))));
    };
    let current = state.models.first();
    let trial = if state.trial_starts.is_some() { Trial::Runs } else { Trial::Ended };
    let about = list.history.iter().filter(|entry| entry.digest == digest);
    Some(Ok(Listed {
        current: current.filter(|current| *current == digest).map(|_| trial),
        events: about.map(|entry| Event { what: entry.what, why: clean(&entry.why) }).collect(),
        runs: current.map_or_else(
            || "no network".to_owned(),
            |current| model_for_people(current, &list.history),
        ),
    }))
}

/// A model by its name and the first digits of its digest.
fn model_for_people(digest: &str, history: &[EntryJson]) -> String {
    let named = history.iter().rev().find(|entry| entry.digest == digest && !entry.name.is_empty());
    let short: String = digest.chars().take(12).collect();
    clean(&named.map_or_else(|| short.clone(), |entry| format!("{} {short}", entry.name)))
}

/// Reads the output of `model install --json`; `None` if it is no answer.
#[must_use]
pub fn read_install(output: &str) -> Option<Judged> {
    let said: InstallJson = serde_json::from_str(object(output)?).ok()?;
    Some(match (said.accepted, said.kind.as_str()) {
        (true, _) => Judged::Accepted,
        (false, "current") => Judged::Current,
        (false, kind) => Judged::Refused { why: clean(&format!("{kind}: {}", said.why)) },
    })
}

/// A robot's text in one line, without characters that control a terminal, and not longer than a page.
#[must_use]
pub fn clean(text: &str) -> String {
    let words: Vec<String> = text
        .split_whitespace()
        .map(|word| word.chars().filter(|letter| !letter.is_control()).collect())
        .collect();
    words.join(" ").chars().take(MAX_TEXT_LEN).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_says_whether_the_model_is_on_trial_and_what_happened_to_it() {
        let list = |state: &str| {
            let history = r#"[{"unix_s":1,"what":"installed","digest":"aa","name":"new","why":""},
                {"unix_s":2,"what":"refused","digest":"bb","name":"other","why":"slow"},
                {"unix_s":3,"what":"promoted","digest":"aa","name":"","why":"a\nb"}]"#;
            let history = history.replace('\n', "");
            let line = format!(r#"{{"state":{state},"problem":null,"history":{history}}}"#);
            read_list(&format!("Welcome\n{line}\n"), "aa").unwrap().unwrap()
        };
        let trial = list(r#"{"models":["aa","cc"],"trial_starts":0}"#);
        assert_eq!((trial.current, trial.runs.as_str()), (Some(Trial::Runs), "new aa"));
        let whats: Vec<What> = trial.events.iter().map(|event| event.what).collect();
        assert_eq!(whats, [What::Installed, What::Other]);
        assert_eq!(list(r#"{"models":["aa"]}"#).current, Some(Trial::Ended));
        let other = list(r#"{"models":["cc","aa"],"trial_starts":1}"#);
        assert_eq!((other.current, other.runs.as_str()), (None, "cc"));
        assert_eq!(list(r#"{"models":[]}"#).runs, "no network");
    }

    #[test]
    fn a_damaged_store_is_a_problem_and_other_output_is_no_list() {
        let damaged = r#"{"state":null,"problem":"current is damaged","history":[]}"#;
        assert_eq!(read_list(damaged, "aa"), Some(Err("current is damaged".to_owned())));
        for output in ["", "sudo: a password is required", "{", "{\"accepted\":true}x"] {
            assert_eq!(read_list(output, "aa"), None, "{output}");
            assert_eq!(read_install(output), None, "{output}");
        }
    }

    #[test]
    fn an_answer_is_accepted_current_or_refused_with_kind_and_reason() {
        let read = |text: &str| read_install(text).unwrap();
        assert_eq!(read(r#"{"accepted":true,"name":"new","digest":"aa"}"#), Judged::Accepted);
        assert_eq!(read(r#"{"accepted":false,"kind":"current","why":"x"}"#), Judged::Current);
        let why = "judged: too slow".to_owned();
        let refused = r#"{"accepted":false,"kind":"judged","why":"too\nslow"}"#;
        assert_eq!(read(refused), Judged::Refused { why });
    }

    #[test]
    fn a_robots_text_cannot_control_the_terminal() {
        assert_eq!(clean("a\x1b[2Jb\r\n c\u{7}"), "a[2Jb c");
        assert_eq!(clean(&"long ".repeat(1000)).chars().count(), MAX_TEXT_LEN);
    }
}
