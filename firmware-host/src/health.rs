//! `firmware-host health`: the state of the running robot on one screen.

use std::fmt::Write as _;
use std::process::ExitCode;

use anyhow::Result;
use comfy_table::{ContentArrangement, Table, presets::NOTHING};
use hal::Clock;
use monotonic_clock::MonotonicClock;
use runtime::lidar_agreement::AgreementStats;
use runtime::localization::Gyroscope;
use runtime::safety::WheelError;

use crate::cli::HealthArgs;
use crate::failure::sentence;
use crate::output;
use crate::report::fit;
use crate::run::status::{DeviceHealth, PowerStatus, Status, unix_s};

/// The running robot writes its status twice a second.
const WATCH_NS: u64 = 500_000_000;

/// Prints the state of the running robot. The exit code is 1 if it is unhealthy.
///
/// # Errors
/// When there is no status file, or when another version wrote it.
pub fn run(args: &HealthArgs) -> Result<ExitCode> {
    if args.json {
        let status = Status::read(&args.status)?;
        println!("{}", serde_json::to_string_pretty(&status)?);
        return Ok(exit_code(&status));
    }
    if !args.watch {
        let status = Status::read(&args.status)?;
        print!("{}", screen(&status, unix_s(), fit::columns()));
        return Ok(exit_code(&status));
    }
    let mut clock = MonotonicClock;
    while !output::is_closed() {
        let text = match Status::read(&args.status) {
            Ok(status) => screen(&status, unix_s(), fit::columns()),
            Err(error) => fit::text(&format!("{}\n", sentence(&error)), fit::columns()),
        };
        // Cursor to the top left, each line cleared to its end, then everything below cleared: this does not flicker.
        print!("\x1b[H{}\x1b[J", text.replace('\n', "\x1b[K\n"));
        output::flush();
        clock.sleep_until_ns(clock.now_ns() + WATCH_NS);
    }
    Ok(ExitCode::SUCCESS)
}

fn exit_code(status: &Status) -> ExitCode {
    if status.worries(unix_s()).is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// The whole screen, for a terminal of this width.
fn screen(status: &Status, now_unix_s: f64, columns: Option<usize>) -> String {
    let mut out = String::new();
    let worries = status.worries(now_unix_s);
    let arming = status.arming();
    let verdict = match (worries.is_empty(), &arming) {
        (false, _) => "UNHEALTHY",
        (true, Some(_)) => "healthy, but disarmed",
        (true, None) => "healthy",
    };
    let _ =
        writeln!(out, "robot: {verdict}   (pid {}, up {})\n", status.pid, span(status.uptime_s));
    for worry in &worries {
        let _ = writeln!(out, "  ! {worry}");
    }
    if let Some(arming) = &arming {
        let _ = writeln!(out, "  > {arming}");
    }
    if !worries.is_empty() || arming.is_some() {
        out.push('\n');
    }
    let _ = writeln!(out, "{}\n", fit::table(&devices(status), columns));
    if let Some(power) = power(&status.power) {
        let _ = writeln!(out, "power        {power}");
    }
    if let Some(line) = &status.stop_line {
        let _ = writeln!(out, "stop line    {}: {}", line.place, line.words());
    }
    let safety = &status.safety;
    let last = safety.last_stop.as_ref().map_or_else(
        || "no stop yet".to_owned(),
        |stop| format!("last stop {} ago: {}", span(now_unix_s - stop.unix_s), stop.why),
    );
    let _ = writeln!(
        out,
        "safety       {} for {}; {last}; {} stops for obstacles",
        safety.state,
        span(safety.for_s),
        safety.stops
    );
    let most = WheelError::MOST;
    let _ = writeln!(
        out,
        "wheels       {:+.2} m and {:+.0} degrees from the scanner's motion; the robot stops at {:.2} m or {:.0} degrees",
        safety.wheel_error_m,
        safety.wheel_error_deg,
        most.forward_m,
        most.yaw_rad.to_degrees()
    );
    let priority =
        if safety.realtime { "with real-time priority" } else { "without real-time priority" };
    let _ = writeln!(
        out,
        "loop         {} ticks, {} skipped, latest tick {:.1} ms late, {priority}",
        safety.steps,
        safety.skipped,
        safety.worst_late_us / 1e3
    );
    let exploration = &status.exploration;
    let goal = exploration.goal.as_deref().unwrap_or("no goal");
    let _ = writeln!(
        out,
        "exploration  {}: {goal}; {:.1} m2 of floor mapped; {} ticks of {:.1} ms (p99 {:.1} ms), {} skipped",
        exploration.policy,
        exploration.mapped_m2,
        exploration.ticks,
        exploration.tick_p50_ms,
        exploration.tick_p99_ms,
        exploration.skipped
    );
    if let Some(why) = &exploration.lost {
        let _ = writeln!(out, "             lost: {why}");
    }
    if let Some(why) = &exploration.no_depth {
        let _ = writeln!(out, "             {why}");
    }
    if let Some(line) = &exploration.line {
        let accuracy = depth_accuracy(line, &exploration.line_by_distance);
        let _ = writeln!(out, "depth        {accuracy}");
    }
    if let Some(gyroscope) = &exploration.gyroscope {
        let _ = writeln!(out, "gyroscope    {}", gyroscope_errors(gyroscope));
    }
    if let Some(digest) = &exploration.model {
        let trial = if exploration.on_trial.is_some() { ", on trial" } else { "" };
        let _ = writeln!(out, "model        {}{trial}", digest.get(..12).unwrap_or(digest));
    }
    let recording = &status.recording;
    let folder = recording.folder.as_deref().unwrap_or("off");
    let _ = write!(out, "recording    {folder}, {} ticks not recorded", recording.dropped);
    if recording.removed > 0 {
        let _ = write!(
            out,
            "; {} old segments removed, {} of them before they were pulled",
            recording.removed, recording.removed_unpulled
        );
    }
    out.push('\n');
    fit::text(&out, columns)
}

/// Bias and scale of the gyroscope, as the scans show them.
fn gyroscope_errors(gyroscope: &Gyroscope) -> String {
    if gyroscope.is_refused {
        return "contradicts the scans and is not used any more: check the mount in [devices.imu]"
            .to_owned();
    }
    format!(
        "{:+.2} degrees per second at rest, {:+.1} % of a rotation",
        gyroscope.bias_radps.to_degrees(),
        100.0 * gyroscope.scale
    )
}

/// What the base reports about its supply and its temperature; `None` if it reports nothing.
fn power(power: &PowerStatus) -> Option<String> {
    let slower = if power.is_hot { ", too hot for full speed" } else { "" };
    let parts = [
        power.voltage_v.map(|volts| format!("{volts:.1} V")),
        power.current_a.map(|amperes| format!("{amperes:.1} A")),
        power.temperature_c.map(|degrees| format!("{degrees:.0} degrees Celsius{slower}")),
    ];
    let reported: Vec<String> = parts.into_iter().flatten().collect();
    (!reported.is_empty()).then(|| reported.join(", "))
}

/// Accuracy of the depth where the LiDAR measures the same points.
fn depth_accuracy(all: &AgreementStats, by_distance: &[AgreementStats]) -> String {
    let error = all.scale - 1.0;
    let direction = if error < 0.0 { "short" } else { "long" };
    let mut text = format!(
        "{} within 25 % of the LiDAR, {} too {direction} on average; {} of the LiDAR's points have depth",
        percent(all.delta1),
        percent(error.abs()),
        percent(all.share)
    );
    let mut separator = "; within 25 %: ";
    for bin in by_distance {
        let correct = percent(bin.delta1);
        let _ = match bin.to_m {
            Some(to_m) => write!(text, "{separator}{:.0}-{to_m:.0} m {correct}", bin.from_m),
            None => write!(text, "{separator}beyond {:.0} m {correct}", bin.from_m),
        };
        separator = ", ";
    }
    text
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

fn devices(status: &Status) -> Table {
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["device", "state", "rate", "age", "good", "bad", "lost", "reopened"]);
    for device in status.devices() {
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

/// A duration in the unit that a person would choose.
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
    use hal::PowerReport;

    fn device(name: &str) -> DeviceHealth {
        DeviceHealth {
            name: name.to_owned(),
            state: "working".to_owned(),
            rate_hz: 40.0,
            age_s: Some(0.012),
            ..DeviceHealth::default()
        }
    }

    fn working() -> Status {
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
    fn the_screen_fits_a_terminal_of_40_columns() {
        let mut status = working();
        status.lidar.state = "disconnected".to_owned();
        status.lidar.problem =
            Some("/dev/embodied-depth/lidar is not there: plug it in".to_owned());
        status.recording.folder = Some("/var/lib/embodied-depth/2026-11".to_owned());
        let text = screen(&status, 100.5, Some(40));
        assert!(text.lines().all(|line| line.chars().count() <= 40), "{text}");
        assert!(text.contains("camera\n  state     working\n  rate      40.0 Hz\n"), "{text}");
    }

    #[test]
    fn the_screen_says_healthy_or_what_is_wrong() {
        let text = screen(&working(), 100.5, None);
        assert!(
            text.starts_with("robot: healthy")
                && text.contains("40.0 Hz")
                && text.contains("12 ms"),
            "{text}"
        );
        assert!(text.contains("last stop 1 min ago: tripped"), "{text}");
        assert!(!text.contains("power"), "nothing is reported: {text}");
        let mut reporting = working();
        let report =
            PowerReport { voltage_v: Some(23.6), current_a: None, temperature_c: Some(41.0) };
        reporting.power = PowerStatus::new(&report, 80.0);
        let text = screen(&reporting, 100.5, None);
        assert!(text.contains("power        23.6 V, 41 degrees Celsius\n"), "{text}");
        let mut with_imu = working();
        with_imu.imu = Some(device("IMU bmi160"));
        let gyroscope = Gyroscope { bias_radps: -0.02, scale: 0.004, is_refused: false };
        with_imu.exploration.gyroscope = Some(gyroscope);
        let text = screen(&with_imu, 100.5, None);
        assert!(text.contains(" IMU bmi160  working"), "{text}");
        let learnt = "gyroscope    -1.15 degrees per second at rest, +0.4 % of a rotation\n";
        assert!(text.contains(learnt), "{text}");
        with_imu.exploration.gyroscope = Some(Gyroscope { is_refused: true, ..gyroscope });
        assert!(screen(&with_imu, 100.5, None).contains("gyroscope    contradicts the scans"));
        let mut disarmed = working();
        disarmed.pid = 7;
        disarmed.safety.state = "disarmed".to_owned();
        let text = screen(&disarmed, 100.5, None);
        assert!(text.starts_with("robot: healthy, but disarmed"), "{text}");
        assert!(text.contains("kill -USR1 7") && text.contains("systemctl kill"), "{text}");
        let mut broken = working();
        broken.lidar.state = "silent".to_owned();
        let text = screen(&broken, 100.5, None);
        assert!(
            text.starts_with("robot: UNHEALTHY") && text.contains("! LiDAR is silent"),
            "{text}"
        );
    }
}
