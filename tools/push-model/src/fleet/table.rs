//! The status of a rollout as a table for people and as JSON for programs.

use std::path::Path;

use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use serde_json::{Value, json};

use super::file::Rules;
use super::rollout::{Counts, Standing, robots_in_words};
use super::state::{Record, Rollout, Verdict};

/// Width of the table in columns. Longer reasons continue in the next line of their cell.
const WIDTH: u16 = 150;

/// Every robot in one row.
#[must_use]
pub fn robots(rollout: &Rollout) -> String {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
    table.set_width(WIDTH);
    table.set_header(["robot", "ring", "verdict", "since (UTC)", "runs", "reason"]);
    let mut records: Vec<&Record> = rollout.robots.iter().collect();
    records.sort_by_key(|record| record.ring);
    for record in records {
        table.add_row([
            record.name.clone(),
            rollout.ring_name(record.ring).to_owned(),
            verdict(record).to_owned(),
            utc(record.unix_s),
            record.runs.clone(),
            reason(record),
        ]);
    }
    let lines: Vec<String> = table.lines().map(|line| line.trim_end().to_owned()).collect();
    lines.join("\n")
}

fn verdict(record: &Record) -> &'static str {
    match record.verdict {
        Verdict::Waiting if record.problem.is_some() => "unreachable",
        verdict => verdict.words(),
    }
}

fn reason(record: &Record) -> String {
    let excused = if record.is_excused && record.verdict.has_failed() {
        "not counted since --resume: "
    } else {
        ""
    };
    match &record.problem {
        Some(problem) => format!("not reached: {problem}"),
        None => format!("{excused}{}", record.reason),
    }
}

/// The rollout in a few lines: its rings, and what it waits for.
#[must_use]
pub fn summary(rollout: &Rollout, rules: &Rules) -> String {
    let digest: String = rollout.digest.chars().take(12).collect();
    let mut lines = vec![format!(
        "model {} ({digest}), rollout begun {}",
        rollout.model,
        utc(rollout.begun_unix_s)
    )];
    for ring in 0..rollout.rings.len() {
        let counts = rollout.counts(ring);
        if counts.all > 0 {
            let name = rollout.ring_name(ring);
            lines.push(format!("ring {name}: {}", ring_words(counts, ring <= rollout.open)));
        }
    }
    lines.push(standing_words(rollout, rules));
    lines.join("\n")
}

fn ring_words(counts: Counts, has_begun: bool) -> String {
    if !has_begun {
        return format!("not begun, {}", robots_in_words(counts.all));
    }
    let parts = [
        (counts.on_trial, "on trial"),
        (counts.failed, "refused, rolled back or replaced"),
        (counts.excused, "not counted since --resume"),
        (counts.unanswered(), "unanswered"),
    ];
    let parts = parts.iter().filter(|(count, _)| *count > 0);
    let parts: String = parts.map(|(count, words)| format!(", {count} {words}")).collect();
    format!("{} of {} kept{parts}", counts.kept, counts.all)
}

fn standing_words(rollout: &Rollout, rules: &Rules) -> String {
    match (rollout.standing(), &rollout.halted) {
        (Standing::Halted, Some(halt)) => format!(
            "halted {}: {}\nNothing more is sent. --resume goes on in spite of this; a corrected model begins a new rollout.",
            utc(halt.unix_s),
            halt.why
        ),
        (Standing::Complete, _) => "complete".to_owned(),
        _ => format!("waiting: {}", waits_for(rollout, rules)),
    }
}

fn waits_for(rollout: &Rollout, rules: &Rules) -> String {
    let is_last = rollout.open + 1 == rollout.rings.len();
    match rollout.lacks(rules).filter(|_| !is_last) {
        Some(lacks) => lacks,
        None => "robots have not answered yet, or are on trial".to_owned(),
    }
}

/// The status for programs.
#[must_use]
pub fn as_json(rollout: &Rollout, rules: &Rules, state: &Path) -> Value {
    let rings = rollout.rings.iter().enumerate().map(|(ring, name)| {
        let counts = rollout.counts(ring);
        json!({
            "name": name, "begun": ring <= rollout.open, "robots": counts.all, "kept": counts.kept,
            "on_trial": counts.on_trial, "failed": counts.failed, "excused": counts.excused,
            "unanswered": counts.unanswered(),
        })
    });
    let robots = rollout.robots.iter().map(|record| {
        json!({
            "name": record.name, "ring": rollout.ring_name(record.ring), "verdict": record.verdict,
            "reason": record.reason, "problem": record.problem, "unix_s": record.unix_s,
            "runs": record.runs, "excused": record.is_excused,
        })
    });
    let standing = match rollout.standing() {
        Standing::Waiting => "waiting",
        Standing::Complete => "complete",
        Standing::Halted => "halted",
    };
    json!({
        "standing": standing, "model": rollout.model, "digest": rollout.digest,
        "begun_unix_s": rollout.begun_unix_s, "state": state, "halted": rollout.halted,
        "waits_for": (standing == "waiting").then(|| waits_for(rollout, rules)),
        "rings": rings.collect::<Vec<_>>(), "robots": robots.collect::<Vec<_>>(),
    })
}

/// A Unix time as `2026-11-22 09:41`, UTC.
fn utc(unix_s: u64) -> String {
    match i64::try_from(unix_s).ok().and_then(|second| jiff::Timestamp::from_second(second).ok()) {
        Some(time) => time.strftime("%Y-%m-%d %H:%M").to_string(),
        None => format!("second {unix_s}"),
    }
}
