//! `firmware-host buffer verify`: checksums and signatures of segments.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use segment_store::{
    Entry, Finding, KnownRobots, Name, Root, Signed, State, Verified, check_signature,
};

use super::{exit_code, segments, tell_missing, tell_unread, until};

/// Verifies all checksums and signatures. The exit code is 1 unless all segments can be read and are whole and, if `robots` is
/// given, these robots recorded them. Segments that are missing between others are named only: a robot deletes segments for space.
pub(super) fn run(path: &Path, robots: Option<&Path>) -> Result<ExitCode> {
    let robots = robots.map(read_robots).transpose()?;
    let (root, catalogue) = segments(path)?;
    let is_all_read = tell_unread(&catalogue);
    let entries = &catalogue.entries;
    let mut broken = 0;
    let mut strange = 0;
    for entry in entries {
        let (verified, author) = examine(&root, entry, robots.as_ref())?;
        let is_whole = matches!(verified.finding, Finding::Whole | Finding::Unindexed);
        let is_open = entry.state == State::Open;
        broken += u32::from(!is_whole && !is_open);
        strange += u32::from(!author.is_accepted && !is_open);
        println!(
            "{}: {}; {} ticks{}; blake3 {}; {}",
            entry.name,
            words(&verified.finding, entry),
            verified.ticks,
            until(verified.last_ns),
            verified.digest,
            author.words
        );
    }
    if broken > 0 {
        println!(
            "not whole: {broken} of {}; `buffer recover` keeps their intact chunks",
            entries.len()
        );
    }
    if strange > 0 {
        println!("not recorded by a known robot: {strange} of {}", entries.len());
    }
    tell_missing(&catalogue);
    Ok(exit_code(is_all_read && broken + strange == 0))
}

fn read_robots(path: &Path) -> Result<KnownRobots> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the known robots {}", path.display()))?;
    KnownRobots::parse(&text).with_context(|| path.display().to_string())
}

/// Who recorded a segment.
struct Author {
    words: String,
    /// Without known robots, everybody is accepted whose signature is not wrong.
    is_accepted: bool,
}

fn examine(root: &Root, entry: &Entry, robots: Option<&KnownRobots>) -> Result<(Verified, Author)> {
    let name = &entry.name;
    let file = root.open_file(name).with_context(|| format!("cannot open {name}"))?;
    let verified = segment_store::verify(&file).with_context(|| format!("cannot read {name}"))?;
    let signed = check_signature(&file).with_context(|| format!("cannot read {name}"))?;
    Ok((verified, author(&signed, name, robots)))
}

fn author(signed: &Signed, name: &Name, robots: Option<&KnownRobots>) -> Author {
    let (words, is_accepted) = match signed {
        Signed::No => ("not signed".to_owned(), robots.is_none()),
        Signed::Wrong(why) => (format!("WRONG SIGNATURE: {why}"), false),
        Signed::By(statement) if name.number() != Some(statement.segment) => {
            (format!("WRONG SIGNATURE: it is that of segment {}", statement.segment), false)
        }
        Signed::By(statement) => {
            let key = statement.robot.get(..8).unwrap_or_default();
            match robots.map(|robots| robots.name_of(&statement.robot)) {
                None => (format!("signed by {key}"), true),
                Some(Some(name)) => (format!("signed by {name}"), true),
                Some(None) => (format!("signed by an unknown robot, {key}"), false),
            }
        }
    };
    Author { words, is_accepted }
}

fn words(finding: &Finding, entry: &Entry) -> String {
    match finding {
        Finding::Whole => "whole".to_owned(),
        Finding::Unindexed => "whole, without an index".to_owned(),
        Finding::Cut { at } => {
            let what = if entry.state == State::Open { "still being written" } else { "cut" };
            format!("{what}: complete up to byte {at} of {}", entry.bytes)
        }
        Finding::Corrupt { at, detail } => format!("CORRUPT at byte {at}: {detail}"),
    }
}

#[cfg(test)]
mod tests {
    use segment_store::signature::Statement;

    use super::*;

    fn signed(robot: &str, segment: u32) -> Signed {
        let robot = robot.to_owned();
        let (run, previous, digest) = <(String, String, String)>::default();
        Signed::By(Statement { robot, run, segment, previous, digest })
    }

    #[test]
    fn a_segment_is_accepted_if_a_known_robot_signed_it_under_its_name() {
        let [kitchen, other] = ["ab", "cd"].map(|byte| byte.repeat(32));
        let robots = KnownRobots::parse(&format!("{kitchen} kitchen\n")).unwrap();
        let name = Name::parse("monday/recording_0003.mcap").unwrap();
        for (signed, known, expected, is_accepted) in [
            (signed(&kitchen, 3), Some(&robots), "signed by kitchen", true),
            (signed(&kitchen, 3), None, "signed by abababab", true),
            (signed(&other, 3), Some(&robots), "signed by an unknown robot, cdcdcdcd", false),
            (signed(&kitchen, 2), None, "WRONG SIGNATURE: it is that of segment 2", false),
            (Signed::No, None, "not signed", true),
            (Signed::No, Some(&robots), "not signed", false),
            (Signed::Wrong("it is not"), None, "WRONG SIGNATURE: it is not", false),
        ] {
            let found = author(&signed, &name, known);
            assert_eq!((found.words.as_str(), found.is_accepted), (expected, is_accepted));
        }
    }
}
