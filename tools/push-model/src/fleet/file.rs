//! The file of a fleet: its robots, and when a rollout goes on and when it halts.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use toml::Spanned;

use crate::target::Target;

/// Longest name of a robot, in characters, so that tables stay readable.
const MAX_NAME_LEN: usize = 40;

/// A fleet, as its file describes it.
#[derive(Debug, Clone)]
pub struct Fleet {
    pub rules: Rules,
    pub robots: Vec<Robot>,
}

/// One robot of a fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Robot {
    pub name: String,
    pub target: Target,
    /// Whether it is sent a new model before all others.
    pub is_canary: bool,
}

/// When a rollout goes on and when it halts: the section `[rollout]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rules {
    /// The rings after the canaries: how much of the other robots each one reaches, in percent.
    pub rings_percent: Vec<usize>,
    /// Number of canaries that may refuse the model or roll it back.
    pub max_failed_canaries: usize,
    /// Share of a later ring's answered robots that may refuse the model or roll it back.
    pub max_failed_percent: usize,
    /// Share of a ring's other robots that must have kept the model before the next ring begins.
    pub kept_percent: usize,
    /// A robot that was sent the model, and neither answered nor knows it after this time, is sent it again.
    pub resend_after_s: u64,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            rings_percent: vec![10, 100],
            max_failed_canaries: 0,
            max_failed_percent: 10,
            kept_percent: 100,
            // Three times the default of the robot's `models.gate_timeout_s` (10 min), after which its examination has ended.
            resend_after_s: 30 * 60,
        }
    }
}

/// The file as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    #[serde(default)]
    rollout: WrittenRules,
    #[serde(default)]
    robot: Vec<WrittenRobot>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenRules {
    rings_percent: Option<Spanned<Vec<i64>>>,
    max_failed_canaries: Option<Spanned<i64>>,
    max_failed_percent: Option<Spanned<i64>>,
    kept_percent: Option<Spanned<i64>>,
    resend_after_min: Option<Spanned<i64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenRobot {
    name: Spanned<String>,
    target: Spanned<String>,
    #[serde(default)]
    canary: bool,
}

/// The file's text, to name lines in errors.
struct Source<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Source<'_> {
    /// `FILE line N`.
    fn line(&self, offset: usize) -> String {
        format!("{} line {}", self.path.display(), self.number(offset))
    }

    fn number(&self, offset: usize) -> usize {
        let before = self.text.as_bytes().get(..offset).unwrap_or_default();
        1 + before.iter().filter(|byte| **byte == b'\n').count()
    }

    /// The value of a key of `[rollout]`, which must be in `range`.
    fn number_in(
        &self,
        key: &str,
        written: Option<&Spanned<i64>>,
        range: RangeInclusive<usize>,
        default: usize,
    ) -> Result<usize> {
        let Some(written) = written else { return Ok(default) };
        let value = usize::try_from(*written.get_ref()).ok().filter(|value| range.contains(value));
        value.with_context(|| {
            format!(
                "`rollout.{key} = {}` in {} is not allowed: it must be {} to {}",
                written.get_ref(),
                self.line(written.span().start),
                range.start(),
                range.end()
            )
        })
    }
}

impl Fleet {
    /// Reads the file of a fleet.
    ///
    /// # Errors
    /// When it cannot be read, is not TOML, or has unknown keys, wrong values, no canary, or a robot twice.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| {
            format!("cannot read the fleet's file {}; check the path", path.display())
        })?;
        Self::parse(path, &text)
    }

    /// Like [`read`](Self::read), from a text. Folders of robots on this computer are relative to the file's own folder, so that a
    /// timer finds them too.
    fn parse(path: &Path, text: &str) -> Result<Self> {
        let source = Source { path, text };
        let written: Written = toml::from_str(text).map_err(|error| {
            let start = error.span().map_or(0, |span| span.start);
            anyhow::anyhow!(
                "{}: {}; docs/models.md has an example of this file",
                source.line(start),
                error.message()
            )
        })?;
        let mut robots = Vec::new();
        for robot in &written.robot {
            robots.push(read_robot(&source, robot)?);
        }
        refuse_duplicates(&source, &written.robot, &robots)?;
        let canaries = robots.iter().filter(|robot| robot.is_canary).count();
        if robots.is_empty() {
            bail!(
                "{} has no robot; add [[robot]] with name and target for each robot",
                path.display()
            );
        }
        if canaries == 0 {
            bail!(
                "{} has no canary; write `canary = true` for at least one robot, which is sent the model first",
                path.display()
            );
        }
        let rules = read_rules(&source, &written.rollout, canaries)?;
        Ok(Self { rules, robots })
    }

    #[must_use]
    pub fn robot(&self, name: &str) -> Option<&Robot> {
        self.robots.iter().find(|robot| robot.name == name)
    }
}

fn read_rules(source: &Source<'_>, written: &WrittenRules, canaries: usize) -> Result<Rules> {
    let default = Rules::default();
    let minutes = source.number_in(
        "resend_after_min",
        written.resend_after_min.as_ref(),
        1..=100_000,
        usize::try_from(default.resend_after_s / 60)?,
    )?;
    Ok(Rules {
        rings_percent: match &written.rings_percent {
            Some(rings) => read_rings(source, rings)?,
            None => default.rings_percent,
        },
        // At least one canary must have kept the model.
        max_failed_canaries: source.number_in(
            "max_failed_canaries",
            written.max_failed_canaries.as_ref(),
            0..=canaries - 1,
            default.max_failed_canaries,
        )?,
        max_failed_percent: source.number_in(
            "max_failed_percent",
            written.max_failed_percent.as_ref(),
            0..=50,
            default.max_failed_percent,
        )?,
        kept_percent: source.number_in(
            "kept_percent",
            written.kept_percent.as_ref(),
            80..=100,
            default.kept_percent,
        )?,
        resend_after_s: 60 * minutes as u64,
    })
}

fn read_rings(source: &Source<'_>, written: &Spanned<Vec<i64>>) -> Result<Vec<usize>> {
    let rings = written.get_ref();
    let ascends = rings.windows(2).all(|pair| pair[0] < pair[1]);
    if !ascends || rings.first().is_none_or(|first| *first < 1) || rings.last() != Some(&100) {
        bail!(
            "`rollout.rings_percent = {rings:?}` in {} is not allowed: the numbers must ascend from 1 or more and end with 100, such as [10, 100]",
            source.line(written.span().start)
        );
    }
    rings.iter().map(|percent| Ok(usize::try_from(*percent)?)).collect()
}

fn read_robot(source: &Source<'_>, written: &WrittenRobot) -> Result<Robot> {
    let name = written.name.get_ref();
    let length = name.chars().count();
    if !(1..=MAX_NAME_LEN).contains(&length) || name.contains(char::is_control) {
        bail!(
            "`name = {name:?}` in {} is not allowed: a robot's name has 1 to {MAX_NAME_LEN} printable characters",
            source.line(written.name.span().start)
        );
    }
    let target = Target::parse(written.target.get_ref()).with_context(|| {
        format!("`target` of robot `{name}` in {}", source.line(written.target.span().start))
    })?;
    Ok(Robot { name: name.clone(), target: beside(source.path, target), is_canary: written.canary })
}

/// Makes the folder of a robot on this computer relative to the folder of the file.
fn beside(file: &Path, target: Target) -> Target {
    match target {
        Target::Local { store } => {
            let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
            let store = folder.unwrap_or(Path::new(".")).join(PathBuf::from(store));
            Target::Local { store: store.to_string_lossy().into_owned() }
        }
        remote => remote,
    }
}

fn refuse_duplicates(
    source: &Source<'_>,
    written: &[WrittenRobot],
    robots: &[Robot],
) -> Result<()> {
    let mut names = HashMap::new();
    let mut targets = HashMap::new();
    for (written, robot) in written.iter().zip(robots) {
        let name_at = written.name.span().start;
        if let Some(first) = names.insert(&robot.name, name_at) {
            bail!(
                "the name `{}` in {} is already that of the robot in line {}; give each robot its own name",
                robot.name,
                source.line(name_at),
                source.number(first)
            );
        }
        let target_at = written.target.span().start;
        if let Some(first) = targets.insert(&robot.target, target_at) {
            bail!(
                "the target `{}` of robot `{}` in {} is already that of the robot in line {}; a robot must be in the file once",
                written.target.get_ref(),
                robot.name,
                source.line(target_at),
                source.number(first)
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO: &str = "\
[[robot]]
name = \"kitchen\"
target = \"robot@kitchen.local\"
canary = true

[[robot]]
name = \"hall\"
target = \"./hall\"
";

    fn parse(text: &str) -> Result<Fleet> {
        Fleet::parse(Path::new("/srv/fleet.toml"), text)
    }

    fn refusal(text: &str) -> String {
        format!("{:#}", parse(text).unwrap_err())
    }

    #[test]
    fn a_file_with_robots_alone_has_three_rings_and_the_default_limits() {
        let fleet = parse(TWO).unwrap();
        assert_eq!(fleet.rules, Rules::default());
        assert!(fleet.robots[0].is_canary && !fleet.robots[1].is_canary);
        let store = "/srv/./hall".to_owned();
        assert_eq!(fleet.robots[1].target, Target::Local { store });
    }

    #[test]
    fn the_example_of_the_documentation_is_a_fleet_with_the_default_rules() {
        let page = include_str!("../../../../docs/models.md");
        let (_, rest) = page.split_once("    [rollout] ").unwrap();
        let lines = rest.lines().take_while(|line| line.is_empty() || line.starts_with("    "));
        let example: Vec<&str> = lines.map(str::trim_start).collect();
        let fleet = parse(&format!("[rollout] {}", example.join("\n"))).unwrap();
        assert_eq!(fleet.rules, Rules::default());
        assert_eq!(fleet.robots.len(), 2);
    }

    #[test]
    fn the_rules_of_the_file_replace_the_defaults() {
        let rules = "[rollout]\nrings_percent = [5, 25, 100]\nmax_failed_percent = 0\nkept_percent = 80\nresend_after_min = 5\n";
        let read = parse(&format!("{rules}{TWO}")).unwrap().rules;
        assert_eq!(read.rings_percent, [5, 25, 100]);
        assert_eq!((read.max_failed_percent, read.kept_percent), (0, 80));
        assert_eq!(read.resend_after_s, 300);
    }

    #[test]
    fn mistakes_are_refused_with_their_line_and_the_way_out() {
        let canary = "[[robot]]\nname = \"a\"\ntarget = \"a\"\ncanary = true\n";
        let cases: [(String, &[&str]); 14] = [
            (String::new(), &["/srv/fleet.toml", "no robot", "[[robot]]"]),
            (canary.replace("true", "false"), &["no canary", "canary = true"]),
            (format!("{canary}colour = 1\n"), &["line 5", "colour", "canary"]),
            (format!("[rolout]\n{canary}"), &["line 1", "rolout", "rollout"]),
            (format!("[rollout]\nringz = 1\n{canary}"), &["line 2", "ringz"]),
            (canary.replace("target = \"a\"\n", ""), &["line 1", "target"]),
            (canary.replace("\"a\"\ncan", "1\ncan"), &["line 3", "string"]),
            (canary.replace("\"a\"\ntar", "\"\"\ntar"), &["line 2", "1 to 40"]),
            (format!("{canary}{canary}"), &["line 6", "`a`", "line 2", "own name"]),
            (
                format!("{canary}[[robot]]\nname = \"b\"\ntarget = \"a:\"\n"),
                &["line 7", "`a:`", "`b`", "line 3", "once"],
            ),
            (
                canary.replace("\"a\"\ncan", "\"-oProxyCommand=x\"\ncan"),
                &["line 3", "`a`", "-oProxyCommand=x", "user@"],
            ),
            (
                format!("[rollout]\nkept_percent = 79\n{canary}"),
                &["line 2", "kept_percent = 79", "80 to 100"],
            ),
            (
                format!("[rollout]\nmax_failed_canaries = 1\n{canary}"),
                &["line 2", "max_failed_canaries = 1", "0 to 0"],
            ),
            (format!("[rollout]\nkept_percent = \"x\n{canary}"), &["line 2", "string"]),
        ];
        for (text, words) in cases {
            let refusal = refusal(&text);
            words.iter().for_each(|word| assert!(refusal.contains(word), "{word}: {refusal}"));
        }
        for rings in ["[]", "[0, 100]", "[10]", "[50, 10, 100]", "[10, 101]", "[-1, 100]"] {
            let refusal = refusal(&format!("[rollout]\nrings_percent = {rings}\n{canary}"));
            assert!(refusal.contains(rings) && refusal.contains("[10, 100]"), "{refusal}");
        }
    }

    #[test]
    fn a_file_that_does_not_exist_is_named() {
        let error = Fleet::read(Path::new("/nowhere/fleet.toml")).unwrap_err();
        assert!(format!("{error:#}").contains("/nowhere/fleet.toml; check the path"), "{error:#}");
    }
}
