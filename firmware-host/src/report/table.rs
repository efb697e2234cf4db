//! The summary as text for a terminal: at most 100 columns, fewer if the terminal has fewer, without colours.

use std::fmt::Write as _;

use comfy_table::{CellAlignment, Table, TableComponent, presets};
use runtime::{
    accuracy::{AccuracyRows, Metrics},
    event::{DropReason, ExploreEnd},
    robot::DepthSource,
};

use super::{
    events::{EventCounts, Reasons, name},
    fit, percent,
    summary::{LidarLine, Summary},
};
use crate::config::Odometry;

/// Maximum number of columns.
const WIDTH: usize = 100;

/// The summary as text that ends with a newline, for the terminal behind standard output.
#[must_use]
pub fn render(summary: &Summary) -> String {
    fitted(summary, fit::columns().map_or(WIDTH, |columns| columns.min(WIDTH)))
}

/// The summary in lines of at most `columns` characters.
fn fitted(summary: &Summary, columns: usize) -> String {
    let mut text = String::new();
    title(&mut text, summary);
    for (label, value) in facts(summary) {
        if !value.is_empty() {
            let _ = writeln!(text, "  {label:<12}  {value}");
        }
    }
    let tables = [accuracy(summary), latency(summary)].into_iter().flatten();
    for table in tables {
        // One column is for the space before each line.
        let rows = fit::table(&table, Some(columns - 1));
        let _ = writeln!(text, "\n {}", rows.replace('\n', "\n "));
    }
    fit::text(&text, Some(columns))
}

fn title(text: &mut String, summary: &Summary) {
    let place = summary.scene.as_ref().or(summary.dataset.as_ref());
    let seed = summary.seed.map(|seed| format!("seed {seed}"));
    let depth = summary.depth_source.map(|source| match source {
        DepthSource::Truth => {
            "ground-truth depth (a test of mapping, not of depth estimation)".to_owned()
        }
        other => format!("{} depth", name(&other)),
    });
    let odometry = (summary.odometry == Some(Odometry::Perfect))
        .then(|| "error-free odometry (tests only)".to_owned());
    let parts: Vec<String> = [place.cloned(), summary.policy.clone(), seed, depth, odometry]
        .into_iter()
        .flatten()
        .collect();
    let _ = writeln!(text, "{}", parts.join(", "));
}

/// Labels and values of all lines. Lines with an empty value are left out.
fn facts(summary: &Summary) -> Vec<(&'static str, String)> {
    let events = &summary.events;
    let trips = stops(summary);
    let goals = events.goals.clone().unwrap_or_default();
    let [chosen, dropped] =
        [&goals.chosen, &goals.dropped].map(|reasons| reasons.values().sum::<u64>());
    // A place that was observed from afar is as good as one that was reached.
    let mut given_up = goals.dropped.clone();
    let seen = given_up.remove(&name(&DropReason::Resolved)).unwrap_or(0);
    let goal_counts = (chosen > 0).then(|| {
        let given_up = dropped - seen;
        format!(
            "{chosen} chosen: {} reached, {seen} seen from afar, {given_up} given up",
            goals.reached
        )
    });
    vec![
        ("frames", frames(summary)),
        (
            "skipped",
            summary
                .skipped_ticks
                .map_or(String::new(), |ticks| format!("{ticks} ticks that would have been late")),
        ),
        ("ended by", summary.end_reason.map_or(String::new(), |end| end_in_words(end).to_owned())),
        ("coverage", coverage(summary)),
        ("map", map(summary)),
        ("pose", pose(summary)),
        ("path", summary.path_m.map_or(String::new(), |path| format!("{path:.1} m"))),
        ("collisions", summary.collisions.map_or(String::new(), |count| count.to_string())),
        ("edges", edges(summary)),
        ("safety stops", trips),
        ("LiDAR check", summary.lidar_line.as_ref().map_or(String::new(), LidarLine::to_string)),
        ("camera", summary.camera_latency.map_or(String::new(), |found| found.to_string())),
        ("faults", counted(&events.safety_faults, "times")),
        ("injected", summary.faults.join(", ")),
        ("stuck", stuck(summary)),
        ("goals", goal_counts.unwrap_or_default()),
        ("chosen for", by_reason(&goals.chosen)),
        ("given up for", by_reason(&given_up)),
        ("no goal", counted(&events.no_goal, "times")),
        ("no depth", counted(&events.no_depth, "frames")),
        ("lost", counted(&events.lost, "times")),
        ("maps", maps(events)),
        ("wheels", counted(&events.wheels_contradicted, "times")),
        ("calibration", counted(&events.calibration_changed, "changes")),
        ("refused", counted(&events.refused_inputs, "inputs")),
        (
            "memory",
            summary.resident_mib.map_or(String::new(), |mib| format!("{mib:.0} MiB at most")),
        ),
        ("recording", recording(summary)),
        (
            "decisions",
            summary
                .digest
                .as_ref()
                .map_or(String::new(), |digest| format!("digest {}", short(digest))),
        ),
    ]
}

fn end_in_words(end: ExploreEnd) -> &'static str {
    match end {
        ExploreEnd::FrameBudget => "the number of frames that was asked for",
        ExploreEnd::Explored => "having seen all floor that can be reached",
        ExploreEnd::Interrupted => "Ctrl-C or a signal",
        ExploreEnd::OutputFailed => "output that cannot be written",
        ExploreEnd::DeviceFailed => "a device that failed for good",
        ExploreEnd::Fell => "a fall over an edge of the floor",
        _ => "another reason",
    }
}

fn frames(summary: &Summary) -> String {
    let mut text = summary.frames.to_string();
    if let Some(wall_s) = summary.wall_s {
        let _ = write!(text, " in {wall_s:.1} s");
    }
    if let Some(rate) = summary.frames_per_s {
        let _ = write!(text, ", {rate:.1} frames/s");
    }
    text
}

fn coverage(summary: &Summary) -> String {
    let Some(coverage) = summary.coverage else { return String::new() };
    let right = summary
        .coverage_true
        .map_or_else(String::new, |share| format!(", {} at its true place", percent(share)));
    match summary.reachable_m2 {
        Some(area) => format!("{} of {area:.1} m2 reachable floor{right}", percent(coverage)),
        None => format!("{} of the reachable floor{right}", percent(coverage)),
    }
}

fn map(summary: &Summary) -> String {
    let error = summary.map_error_m.map(|error| {
        let [p50, p90] = [error.p50, error.p90].map(|metres| 100.0 * metres);
        format!("obstacles within {p50:.1} cm (median), {p90:.1} cm (90 %)")
    });
    let off = summary
        .map_off10
        .map(|share| format!("{} of the occupied cells more than 10 cm off", percent(share)));
    let iou = summary.map_iou.map(|iou| format!("IoU of the free floor {iou:.3}"));
    [error, off, iou].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn pose(summary: &Summary) -> String {
    let Some(error) = &summary.pose_error else { return String::new() };
    let drift =
        error.rpe_m_per_m.zip(error.rpe_deg_per_m).map_or_else(String::new, |(metres, degrees)| {
            format!("{:.1} mm and {degrees:.2} degrees off per metre, ", 1e3 * metres)
        });
    format!(
        "{drift}{:.2} m off over the run, heading {:.1} degrees off at the end",
        error.ate_m, error.yaw_end_deg
    )
}

/// What the safety plane stopped, and for how long.
fn stops(summary: &Summary) -> String {
    let events = &summary.events;
    let trips = Some(counted(&events.bumper_trips_by, "trips")).filter(|trips| !trips.is_empty());
    let escapes = events.bumper_escapes.filter(|escapes| *escapes > 0);
    let parts = [
        trips,
        escapes.map(|escapes| number_of(escapes, "escape")),
        events.view_lost.map(|lost| format!("{} without a view ahead", number_of(lost, "stop"))),
        summary
            .held_frames
            .filter(|held| *held > 0)
            .map(|held| format!("{} held", number_of(held, "frame"))),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// A number with its noun, which has a plural in s.
fn number_of(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

fn edges(summary: &Summary) -> String {
    let Some(approaches) = summary.edge_approaches else { return String::new() };
    let fall = if summary.fell == Some(true) { ", and fell over one" } else { "" };
    format!("{approaches} times within 0.1 m of an edge of the floor{fall}")
}

/// The maps that a robot began because it did not find itself.
fn maps(events: &EventCounts) -> String {
    let Some(begun) = events.maps_begun else { return String::new() };
    format!("{begun} begun where the robot was lost, {} joined", events.maps_joined.unwrap_or(0))
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
    let digest =
        summary.recording_digest.as_ref().map(|digest| format!("digest {}", short(digest)));
    [size, digest].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn short(digest: &str) -> &str {
    digest.get(..16).unwrap_or(digest)
}

/// Counts with their reasons, such as `3 frontier, 1 inconsistency`, most frequent first.
fn by_reason(reasons: &Reasons) -> String {
    let mut sorted: Vec<(&String, &u64)> = reasons.iter().collect();
    sorted.sort_by_key(|(reason, count)| (std::cmp::Reverse(**count), reason.as_str()));
    let parts: Vec<String> =
        sorted.into_iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    parts.join(", ")
}

/// The total with the counts of the reasons, such as `4 frames (3 first_frame, 1 out_of_range)`.
fn counted(reasons: &Reasons, what: &str) -> String {
    match reasons.values().sum::<u64>() {
        0 => String::new(),
        1 => format!("1 {} ({})", what.trim_end_matches('s'), by_reason(reasons)),
        total => format!("{total} {what} ({})", by_reason(reasons)),
    }
}

fn accuracy(summary: &Summary) -> Option<Table> {
    let accuracy = summary.accuracy.as_ref()?;
    let mut table = numbers(&[
        "depth accuracy",
        "share",
        "right of all",
        "delta1",
        "unscaled",
        "abs rel",
        "rmse (m)",
    ]);
    add_source(&mut table, "coarse", accuracy.coarse);
    add_source(&mut table, "dense", accuracy.dense);
    add_source(&mut table, "network", accuracy.network);
    if let Some(row) = accuracy.refined {
        table.add_row(accuracy_row("network, where coarse is".to_owned(), &row));
    }
    if let Some(row) = accuracy.constant.and_then(|constant| constant.all) {
        table.add_row(accuracy_row("constant (median of ground truth)".to_owned(), &row));
    }
    (table.row_count() > 0).then_some(table)
}

fn add_source(table: &mut Table, label: &str, rows: Option<AccuracyRows>) {
    let rows = rows.unwrap_or_default();
    for (which, row) in [("all", rows.all), ("confident half", rows.confident)] {
        if let Some(row) = row {
            table.add_row(accuracy_row(format!("{label}, {which}"), &row));
        }
    }
}

fn accuracy_row(label: String, row: &Metrics) -> Vec<String> {
    let shares = [row.share, row.right].map(|value| format!("{:.0} %", 100.0 * value));
    let values = [row.delta1, row.delta1_unscaled, row.abs_rel, row.rmse_m]
        .map(|value| format!("{value:.3}"));
    std::iter::once(label).chain(shares).chain(values).collect()
}

fn latency(summary: &Summary) -> Option<Table> {
    let mut table = numbers(&["time per frame (ms)", "median", "p99", "max"]);
    for (stage, times) in &summary.latency_ms {
        table.add_row(vec![
            stage.name().to_owned(),
            format!("{:.2}", times.p50),
            format!("{:.2}", times.p99),
            format!("{:.2}", times.max),
        ]);
    }
    (table.row_count() > 0).then_some(table)
}

/// A table with a line below its header. The first column is left-aligned, the others
/// right-aligned.
fn numbers(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    for rule in [TableComponent::HeaderLines, TableComponent::MiddleHeaderIntersections] {
        table.set_style(rule, '─');
    }
    table.set_header(header.iter().copied());
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use runtime::latency::Percentiles;

    use super::*;
    use crate::report::{
        events::{EventCounts, Goals},
        latency::Stage,
        summary::DepthAccuracy,
    };

    fn reasons(pairs: &[(&str, u64)]) -> Reasons {
        pairs.iter().map(|(reason, count)| ((*reason).to_owned(), *count)).collect()
    }

    fn metrics(share: f64, delta1: f64) -> Metrics {
        Metrics {
            share,
            delta1,
            delta1_unscaled: delta1 - 0.02,
            abs_rel: 0.1,
            rmse_m: 0.4,
            ..Metrics::default()
        }
    }

    fn full() -> Summary {
        let rows =
            AccuracyRows { all: Some(metrics(0.71, 0.86)), confident: Some(metrics(0.36, 0.96)) };
        let times = Percentiles { p50: 6.1, p99: 9.7, max: 14.0 };
        Summary {
            frames: 3000,
            seed: Some(7),
            policy: Some("active".into()),
            scene: Some("builtin:house?seed=3".into()),
            depth_source: Some(DepthSource::Network),
            end_reason: Some(ExploreEnd::FrameBudget),
            path_m: Some(81.2),
            coverage: Some(0.83),
            reachable_m2: Some(92.4),
            collisions: Some(4),
            stuck_frames: Some(24),
            stuck_longest_frames: Some(24),
            events: EventCounts {
                goals: Some(Goals {
                    chosen: reasons(&[("frontier", 31), ("inconsistency", 10)]),
                    reached: 30,
                    dropped: reasons(&[("no_progress", 4), ("resolved", 7)]),
                }),
                no_depth: reasons(&[("first_frame", 1), ("too_little_parallax", 209)]),
                bumper_trips: Some(3),
                bumper_trips_by: reasons(&[("lidar_hit", 3)]),
                ..EventCounts::default()
            },
            wall_s: Some(95.1),
            frames_per_s: Some(31.5),
            latency_ms: BTreeMap::from([(Stage::Total, times), (Stage::Coarse, times)]),
            accuracy: Some(DepthAccuracy {
                coarse: Some(rows),
                dense: None,
                network: Some(rows),
                refined: Some(metrics(0.71, 0.87)),
                constant: Some(AccuracyRows { all: Some(metrics(1.0, 0.65)), confident: None }),
            }),
            resident_mib: Some(212.0),
            recording_mib: Some(53.2),
            digest: Some("0123456789abcdef0123456789abcdef".into()),
            ..Summary::default()
        }
    }

    #[test]
    fn every_known_value_is_shown_within_100_columns() {
        let text = fitted(&full(), WIDTH);
        for part in [
            "builtin:house?seed=3, active, seed 7, network depth",
            "3000 in 95.1 s, 31.5 frames/s",
            "ended by      the number of frames",
            "83.0 % of 92.4 m2 reachable floor",
            "24 frames, at most 24 in a row",
            "41 chosen: 30 reached, 7 seen from afar, 4 given up",
            "chosen for    31 frontier, 10 inconsistency",
            "given up for  4 no_progress",
            "210 frames (209 too_little_parallax, 1 first_frame)",
            "3 trips (3 lidar_hit)",
            "network, confident half",
            "network, where coarse is",
            "digest 0123456789abcdef",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(!text.contains('\x1b'), "no colour codes");
    }

    #[test]
    fn every_known_value_is_shown_on_a_terminal_of_40_columns_too() {
        let text = fitted(&full(), 40);
        assert!(text.lines().all(|line| line.chars().count() <= 40), "{text}");
        for part in ["abs rel", "network, confident half", "digest", "time per frame (ms):"] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
    }

    #[test]
    fn unknown_values_are_left_out() {
        let text = fitted(
            &Summary { frames: 360, dataset: Some("redkitchen".into()), ..Summary::default() },
            WIDTH,
        );
        assert_eq!(text, "redkitchen\n  frames        360\n");
    }

    #[test]
    fn long_lists_of_reasons_are_wrapped_in_their_column() {
        let many: Vec<String> =
            (0..12).map(|index| format!("a_rather_long_reason_{index}")).collect();
        let mut summary = full();
        summary.events.no_depth = many.iter().map(|reason| (reason.clone(), 7)).collect();
        let text = fitted(&summary, WIDTH);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(many.iter().all(|reason| text.contains(reason)), "{text}");
    }

    #[test]
    fn the_columns_of_a_table_are_aligned() {
        let text = fitted(&full(), WIDTH);
        let ends: Vec<usize> = text
            .lines()
            .filter(|line| line.contains(" half ") || line.contains("abs rel"))
            .map(|line| line.chars().count())
            .collect();
        assert_eq!(ends.len(), 3, "{text}");
        assert!(ends.iter().all(|end| *end == ends[0]), "{text}");
    }

    #[test]
    fn ground_truth_depth_is_marked_as_such() {
        let text = fitted(
            &Summary { depth_source: Some(DepthSource::Truth), ..Summary::default() },
            WIDTH,
        );
        assert!(text.contains("a test of mapping, not of depth estimation"));
    }
}
