//! The summary as a person reads it in a terminal: at most 100 columns, no colour needed.

use std::fmt::Write as _;

use comfy_table::{CellAlignment, Table, presets};

use super::{
    events::{Reasons, name},
    summary::{AccuracyRow, DepthSource, SourceAccuracy, Summary},
};

/// The whole summary, ending with a newline.
#[must_use]
pub fn render(summary: &Summary) -> String {
    let mut text = String::new();
    title(&mut text, summary);
    for (label, value) in facts(summary) {
        line(&mut text, label, &value);
    }
    if let Some(accuracy) = accuracy(summary) {
        section(&mut text, &accuracy);
    }
    if let Some(latency) = latency(summary) {
        section(&mut text, &latency);
    }
    text
}

fn title(text: &mut String, summary: &Summary) {
    let place = summary.scene.as_ref().or(summary.dataset.as_ref());
    let seed = summary.seed.map(|seed| format!("seed {seed}"));
    let depth = summary.depth_source.map(|source| match source {
        DepthSource::Truth => "ground-truth depth (a test of mapping, not of the robot)".to_owned(),
        other => format!("{} depth", name(&other)),
    });
    let parts: Vec<String> = [place.cloned(), summary.policy.clone(), seed, depth].into_iter().flatten().collect();
    let _ = writeln!(text, "{}", parts.join(", "));
}

fn line(text: &mut String, label: &str, value: &str) {
    if !value.is_empty() {
        let _ = writeln!(text, "  {label:<11} {value}");
    }
}

/// Label and value of every line; an empty value is left out.
fn facts(summary: &Summary) -> Vec<(&'static str, String)> {
    let events = &summary.events;
    let mut trips = format!("{}{}", events.bumper_trips, by_reason(&events.bumper_trips_by));
    if events.bumper_escapes > 0 {
        let _ = write!(trips, ", {} escapes", events.bumper_escapes);
    }
    let goals = &events.goals;
    let (chosen, dropped) = (goals.chosen.values().sum::<u64>(), goals.dropped.values().sum::<u64>());
    let goals = (chosen > 0).then(|| {
        let reached = goals.reached;
        format!("{chosen} chosen{}, {reached} reached, {dropped} dropped{}", by_reason(&goals.chosen), by_reason(&goals.dropped))
    });
    vec![
        ("frames", frames(summary)),
        ("ended by", summary.end_reason.map_or(String::new(), |end| name(&end))),
        ("coverage", coverage(summary)),
        ("path", summary.path_m.map_or(String::new(), |path| format!("{path:.1} m"))),
        ("collisions", summary.collisions.map_or(String::new(), |count| count.to_string())),
        ("bumper", if events.bumper_trips > 0 { trips + if events.bumper_trips == 1 { " trip" } else { "" } } else { String::new() }),
        ("stuck", stuck(summary)),
        ("goals", goals.unwrap_or_default()),
        ("no goal", counted(&events.no_goal, "times")),
        ("no depth", counted(&events.no_depth, "frames")),
        ("refused", counted(&events.refused_inputs, "inputs")),
        ("memory", summary.resident_mib.map_or(String::new(), |mib| format!("{mib:.0} MiB at most"))),
        ("recording", recording(summary)),
        ("decisions", summary.digest.as_ref().map_or(String::new(), |digest| format!("digest {}", short(digest)))),
    ]
}

fn frames(summary: &Summary) -> String {
    let mut text = summary.frames.to_string();
    if let Some(wall_s) = summary.wall_s {
        let _ = write!(text, " in {wall_s:.1} s");
    }
    if let Some(rate) = summary.frames_per_s {
        let _ = write!(text, ", {rate:.1} a second");
    }
    text
}

fn coverage(summary: &Summary) -> String {
    let Some(coverage) = summary.coverage else { return String::new() };
    match summary.reachable_m2 {
        Some(area) => format!("{:.1} % of {area:.1} m2 reachable floor", 100.0 * coverage),
        None => format!("{:.1} % of the reachable floor", 100.0 * coverage),
    }
}

fn stuck(summary: &Summary) -> String {
    match (summary.stuck_frames, summary.stuck_longest_frames) {
        (Some(0), _) => "never".to_owned(),
        (Some(frames), Some(longest)) => format!("{frames} frames, at most {longest} in a row"),
        (Some(frames), None) => format!("{frames} frames"),
        (None, _) => String::new(),
    }
}

fn recording(summary: &Summary) -> String {
    let size = summary.recording_mib.map(|mib| format!("{mib:.1} MiB"));
    let digest = summary.recording_digest.as_ref().map(|digest| format!("digest {}", short(digest)));
    [size, digest].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn short(digest: &str) -> &str {
    digest.get(..16).unwrap_or(digest)
}

/// ` (3 this, 1 that)`, most frequent first.
fn by_reason(reasons: &Reasons) -> String {
    let mut sorted: Vec<(&String, &u64)> = reasons.iter().collect();
    sorted.sort_by_key(|(reason, count)| (std::cmp::Reverse(**count), reason.as_str()));
    let parts: Vec<String> = sorted.into_iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    if parts.is_empty() { String::new() } else { format!(" ({})", parts.join(", ")) }
}

fn counted(reasons: &Reasons, what: &str) -> String {
    let total: u64 = reasons.values().sum();
    if total == 0 { String::new() } else { format!("{total} {what}{}", by_reason(reasons)) }
}

fn accuracy(summary: &Summary) -> Option<Table> {
    let accuracy = summary.accuracy.as_ref()?;
    let mut table = numbers(&["depth accuracy", "share", "delta1", "unscaled", "abs rel", "rmse (m)"]);
    let mut source = |label: &str, of: &Option<SourceAccuracy>| {
        let of = of.unwrap_or_default();
        for (which, row) in [("all", of.all), ("confident half", of.confident)] {
            if let Some(row) = row {
                table.add_row(accuracy_row(format!("{label}, {which}"), &row));
            }
        }
    };
    source("coarse", &accuracy.coarse);
    source("network", &accuracy.network);
    if let Some(row) = accuracy.constant.and_then(|constant| constant.all) {
        table.add_row(accuracy_row("constant (median of the truth)".to_owned(), &row));
    }
    (table.row_count() > 0).then_some(table)
}

fn accuracy_row(label: String, row: &AccuracyRow) -> Vec<String> {
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
    let share = row.share.map_or("-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
    vec![label, share, number(row.delta1), number(row.delta1_unscaled), number(row.abs_rel), number(row.rmse_m)]
}

fn latency(summary: &Summary) -> Option<Table> {
    let mut table = numbers(&["time per frame (ms)", "median", "p99", "max"]);
    for (stage, times) in &summary.latency_ms {
        let number = |value: f64| format!("{value:.2}");
        table.add_row(vec![stage.name().to_owned(), number(times.p50), number(times.p99), number(times.max)]);
    }
    (table.row_count() > 0).then_some(table)
}

/// A table of numbers under a rule: first column left, others right.
fn numbers(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::UTF8_HORIZONTAL_ONLY).remove_style(comfy_table::TableComponent::HorizontalLines);
    table.set_header(header.iter().copied());
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn section(text: &mut String, table: &Table) {
    text.push('\n');
    for row in table.lines() {
        let _ = writeln!(text, " {}", row.trim_end());
    }
}
