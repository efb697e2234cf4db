//! `firmware-host health`: one screen about the running robot.

use std::fmt::Write as _;
use std::process::ExitCode;

use anyhow::Result;
use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use hal::Clock;
use monotonic_clock::MonotonicClock;
use runtime::line_monitor::LineAccuracy;

use crate::cli::HealthArgs;
use crate::failure::sentence;
use crate::run::status::{DeviceHealth, Status, unix_s};

/// The status is written twice a second.
const WATCH_NS: u64 = 500_000_000;

/// Shows how it is. Exits with 1 when something is wrong.
///
/// # Errors
/// When there is no status, or none of this version.
pub fn run(args: &HealthArgs) -> Result<ExitCode> {
    if args.json {
        let status = Status::read(&args.status)?;
        println!("{}", serde_json::to_string_pretty(&status)?);
        return Ok(exit_code(&status));
    }
    if !args.watch {
        let status = Status::read(&args.status)?;
        print!("{}", screen(&status, unix_s()));
        return Ok(exit_code(&status));
    }
    let mut clock = MonotonicClock;
    loop {
        let text = match Status::read(&args.status) {
            Ok(status) => screen(&status, unix_s()),
            Err(error) => format!("{}\n", sentence(&error)),
        };
        // Home, the text with each line cleared to its end, then clear what is below: no flicker.
        print!("\x1b[H{}\x1b[J", text.replace('\n', "\x1b[K\n"));
        std::io::Write::flush(&mut std::io::stdout())?;
        clock.sleep_until_ns(clock.now_ns() + WATCH_NS);
    }
}

fn exit_code(status: &Status) -> ExitCode {
    if status.worries(unix_s()).is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn screen(status: &Status, now_unix_s: f64) -> String {
    let mut out = String::new();
    let worries = status.worries(now_unix_s);
    let verdict = if worries.is_empty() { "well" } else { "NOT WELL" };
    let _ =
        writeln!(out, "robot: {verdict}   (pid {}, up {})\n", status.pid, span(status.uptime_s));
    for worry in &worries {
        let _ = writeln!(out, "  ! {worry}");
    }
    if !worries.is_empty() {
        out.push('\n');
    }
    let _ = writeln!(out, "{}\n", devices(status));
    let safety = &status.safety;
    let last = safety.last_stop.as_ref().map_or_else(
        || "never stopped".to_owned(),
        |stop| format!("last stop {} ago: {}", span(now_unix_s - stop.unix_s), stop.why),
    );
    let _ = writeln!(
        out,
        "safety       {} for {}; {last}; {} obstacles",
        safety.state,
        span(safety.for_s),
        safety.stops
    );
    let priority = if safety.realtime { "real-time priority" } else { "no real-time priority" };
    let _ = writeln!(
        out,
        "loop         {} turns, {} left out, worst {:.1} ms late, {priority}",
        safety.turns,
        safety.skipped,
        safety.worst_late_us / 1e3
    );
    let exploration = &status.exploration;
    let goal = exploration.goal.as_deref().unwrap_or("no goal");
    let _ = writeln!(
        out,
        "exploration  {}: {goal}; {:.1} m2 of floor mapped; {} turns of {:.1} ms (p99 {:.1}), {} left out",
        exploration.policy,
        exploration.mapped_m2,
        exploration.ticks,
        exploration.turn_p50_ms,
        exploration.turn_p99_ms,
        exploration.skipped
    );
    if let Some(why) = &exploration.no_depth {
        let _ = writeln!(out, "             {why}");
    }
    if let Some(line) = &exploration.line {
        let _ = writeln!(out, "depth        {}", depth_words(line, &exploration.line_by_distance));
    }
    if let Some(digest) = &exploration.model {
        let trial = if exploration.on_trial.is_some() { ", on trial" } else { "" };
        let _ = writeln!(out, "model        {}{trial}", digest.get(..12).unwrap_or(digest));
    }
    let recording = &status.recording;
    let folder = recording.folder.as_deref().unwrap_or("off");
    let _ = write!(out, "recording    {folder}, {} turns dropped", recording.dropped);
    if recording.removed > 0 {
        let _ = write!(
            out,
            "; {} old segments removed, {} of them not pulled",
            recording.removed, recording.removed_unpulled
        );
    }
    out.push('\n');
    out
}

/// How right the depth is where the LiDAR sees the same.
fn depth_words(all: &LineAccuracy, by_distance: &[LineAccuracy]) -> String {
    let percent = |share: f64| 100.0 * share;
    let off = percent(all.scale - 1.0);
    let far = if off < 0.0 { "near" } else { "far" };
    let mut words = format!(
        "{:.0} % right within 25 % on the LiDAR's line, {:.0} % too {far}; {:.0} % of it has depth",
        percent(all.delta1),
        off.abs(),
        percent(all.share)
    );
    let mut separator = "; right ";
    for bin in by_distance {
        let to = bin.to_m.map_or("on".to_owned(), |to_m| format!("to {to_m:.0} m"));
        let _ =
            write!(words, "{separator}from {:.0} {to} {:.0} %", bin.from_m, percent(bin.delta1));
        separator = ", ";
    }
    words
}

fn devices(status: &Status) -> Table {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["device", "state", "rate", "age", "good", "bad", "lost", "reopened"]);
    for device in [&status.camera, &status.lidar, &status.base] {
        table.add_row(row(device));
    }
    for column in 2..8 {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(comfy_table::CellAlignment::Right);
        }
    }
    table
}

fn row(device: &DeviceHealth) -> [String; 8] {
    let age = device.age_s.map_or_else(|| "-".to_owned(), |age_s| format!("{:.0} ms", age_s * 1e3));
    [
        device.name.clone(),
        device.state.clone(),
        format!("{:.1} Hz", device.rate_hz),
        age,
        device.good.to_string(),
        device.bad.to_string(),
        device.lost.to_string(),
        device.reopened.to_string(),
    ]
}

/// Seconds as a person says them.
fn span(seconds: f64) -> String {
    match seconds {
        s if s < 60.0 => format!("{s:.1} s"),
        s if s < 3600.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::status::LastStop;

    fn working() -> Status {
        let device = |name: &str| DeviceHealth {
            name: name.to_owned(),
            state: "working".to_owned(),
            rate_hz: 40.0,
            age_s: Some(0.012),
            ..DeviceHealth::default()
        };
        let mut status = Status {
            written_unix_s: 100.0,
            camera: device("camera"),
            lidar: device("LiDAR"),
            base: device("base"),
            ..Status::default()
        };
        status.safety.state = "clear".to_owned();
        status.safety.last_stop = Some(LastStop { why: "tripped".to_owned(), unix_s: 40.0 });
        status
    }

    #[test]
    fn the_screen_says_well_or_what_is_wrong() {
        let text = screen(&working(), 100.5);
        assert!(
            text.starts_with("robot: well") && text.contains("40.0 Hz") && text.contains("12 ms"),
            "{text}"
        );
        assert!(text.contains("last stop 1 min ago: tripped"), "{text}");
        let mut broken = working();
        broken.lidar.state = "silent".to_owned();
        let text = screen(&broken, 100.5);
        assert!(
            text.starts_with("robot: NOT WELL") && text.contains("! LiDAR is silent"),
            "{text}"
        );
    }
}
