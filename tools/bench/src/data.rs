//! Transfer of recordings: `pull-buffer` over ssh on loopback beside `ssh cat` and rsync, and the time to list a large buffer.
//! Without sshd, rsync or the two programs (`BENCH_PROGRAMS`), those rows are absent.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use segment_store::{Catalogue, Root};

use hil::noise;
use hil::sshd::Sshd;

use crate::data_sshd::{self as over, Comparison};
use crate::report::{Row, Timing, Unit, time, time_against};

const AREA: &str = "data";
const RUNS: usize = 5;
/// Number of segments in the pulled buffer, each of the recorder's maximum size.
const SEGMENTS: usize = 4;
const SEGMENT_BYTES: usize = 256 << 20;
const NO_OPTIONS: &[&str] = &[];

/// Measures all rows of this module.
///
/// # Errors
/// When a transfer fails.
pub fn rows() -> Result<Vec<Row>> {
    let scratch = Scratch::new()?;
    let mut rows = vec![listing(&scratch.path("large"))?];
    let programs = std::env::var_os("BENCH_PROGRAMS").map(PathBuf::from);
    match (programs, Sshd::start(&scratch.path("ssh"))?) {
        (Some(programs), Some(sshd)) => rows.extend(pulls(&scratch, &programs, &sshd)?),
        (None, _) => {
            eprintln!(
                "no rows of pull-buffer: BENCH_PROGRAMS is not a folder with pull-buffer and firmware-host"
            );
        }
        (_, None) => eprintln!("no rows of pull-buffer: there is no sshd"),
    }
    Ok(rows)
}

/// Lists 10 GB in 400 sparse segments. Only the index at the end of each is real, and listing reads nothing else.
fn listing(dir: &Path) -> Result<Row> {
    let segment = small_segment()?;
    for number in 0..400 {
        let run = dir.join(format!("run{:02}", number / 40));
        fs::create_dir_all(&run)?;
        sparse(&run.join(format!("recording_{:04}.mcap", number % 40)), &segment, 25_000_000)?;
    }
    let root = Root::open(dir)?;
    let entries = Catalogue::read(&root)?.entries;
    let bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
    ensure!(
        entries.len() == 400 && bytes >= 10_000_000_000,
        "{} segments, {bytes} bytes",
        entries.len()
    );
    ensure!(entries.iter().all(|entry| entry.ticks == Some(20)), "the index was not read");
    let timing = time(20, || Catalogue::read(&root).map(|catalogue| catalogue.entries.len()));
    Ok(Row::seconds(AREA, "list a buffer of 10 GB, 400 segments", timing)
        .goal(0.2, 0.05)
        .note("sizes, times, ticks, events, markers; from the page cache"))
}

/// A complete segment with an index, written by the `mcap` crate.
fn small_segment() -> Result<Vec<u8>> {
    let mut file = Vec::new();
    let options = mcap::WriteOptions::new().compression(None).disable_seeking(true);
    let mut writer = options.create(mcap::write::NoSeek::new(&mut file))?;
    let channel =
        writer.add_channel(0, "/robot/tick", "json", &std::collections::BTreeMap::new())?;
    for sequence in 0..20 {
        let time = u64::from(sequence) * 100_000_000;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, b"{}")?;
    }
    writer.finish()?;
    drop(writer);
    Ok(file)
}

/// Writes a sparse file of `length` bytes that ends with the index of `segment`.
fn sparse(path: &Path, segment: &[u8], length: u64) -> Result<()> {
    let tail = segment.len().checked_sub(37).context("too short")?;
    let summary_start = segment
        .get(tail + 9..tail + 17)
        .and_then(|bytes| bytes.try_into().ok())
        .map(u64::from_le_bytes)
        .context("no footer")?;
    let mut index = segment.get(usize::try_from(summary_start)?..).context("no index")?.to_vec();
    let moved = length - index.len() as u64;
    let field = index.len() - 37 + 9;
    index.get_mut(field..field + 8).context("no footer")?.copy_from_slice(&moved.to_le_bytes());
    let mut file = File::create(path)?;
    file.write_all(segment.get(..8).unwrap_or_default())?;
    file.set_len(moved)?;
    std::io::Seek::seek(&mut file, std::io::SeekFrom::Start(moved))?;
    file.write_all(&index)?;
    // An old modification time marks the segment as finished.
    Ok(file.set_modified(std::time::UNIX_EPOCH)?)
}

fn pulls(scratch: &Scratch, programs: &Path, sshd: &Sshd) -> Result<Vec<Row>> {
    let robot = scratch.path("robot");
    fs::create_dir_all(robot.join("run"))?;
    for number in 0..SEGMENTS {
        let path = robot.join(format!("run/recording_{number:04}.mcap"));
        fs::write(&path, noise(number as u64 + 1, SEGMENT_BYTES))?;
        File::open(&path)?.set_modified(std::time::UNIX_EPOCH)?;
    }
    let here = scratch.path("here");
    let mut peak_mib = Vec::new();
    let (ours, theirs) = both(
        RUNS,
        || {
            remove(&here);
            peak_mib.push(run_measured(over::pull(sshd, NO_OPTIONS, programs, &robot, &here))?);
            Ok(())
        },
        || cat_segments(sshd, &robot, &here),
    )?;
    let mut rows = vec![
        first_copy_row("", ours)
            .peer("ssh cat", rate(theirs).median)
            .note("pull-buffer hashes on both sides and syncs to the disk; ssh cat does neither"),
    ];
    let have_rsync = Command::new("rsync").arg("--version").stdout(Stdio::null()).status().is_ok();
    if have_rsync {
        for (what, more) in [("", NO_OPTIONS), (", AES cipher", over::AES)] {
            for comparison in [Comparison::SizeAndTime, Comparison::Checksum] {
                let (ours, theirs) = both(
                    RUNS,
                    || {
                        remove(&here);
                        peak_mib
                            .push(run_measured(over::pull(sshd, more, programs, &robot, &here))?);
                        Ok(())
                    },
                    || {
                        remove(&here);
                        run(over::rsync(sshd, more, comparison, &robot, &here))
                    },
                )?;
                let row = first_copy_row(what, ours);
                rows.push(row.peer(comparison.name(), rate(theirs).median).note(
                    "pull-buffer hashes on both sides and syncs to the disk; rsync does not sync",
                ));
            }
        }
        rows.extend(nothing_new(scratch, programs, sshd, &robot)?);
    }
    rows.push(
        Row::new(AREA, "pull-buffer, peak resident memory", Unit::Mebibytes, Timing::of(peak_mib))
            .goal(64.0, 24.0),
    );
    Ok(rows)
}

/// Removes what an earlier run has copied.
fn remove(dir: &Path) {
    let _ = fs::remove_dir_all(dir);
}

fn cat_segments(sshd: &Sshd, robot: &Path, here: &Path) -> Result<()> {
    remove(here);
    fs::create_dir_all(here)?;
    for number in 0..SEGMENTS {
        let name = format!("recording_{number:04}.mcap");
        let mut command = over::ssh(sshd);
        command
            .arg(format!("cat {}/run/{name}", robot.display()))
            .stdout(File::create(here.join(name))?);
        run(command)?;
    }
    Ok(())
}

/// The rate of copying the whole buffer, from its duration.
fn rate(timing: Timing) -> Timing {
    let megabytes = (SEGMENTS * SEGMENT_BYTES) as f64 * 1e-6;
    Timing {
        min: megabytes / timing.max,
        median: megabytes / timing.median,
        max: megabytes / timing.min,
    }
}

fn first_copy_row(what: &str, ours: Timing) -> Row {
    let name = format!("pull 1 GiB over ssh, first copy{what}");
    Row::new(AREA, name, Unit::MegabytesPerSecond, rate(ours))
}

/// Later pulls without new data: over a connection that the pull before left open, over a new connection each time, and over a
/// connection that ssh keeps open for both.
fn nothing_new(scratch: &Scratch, programs: &Path, sshd: &Sshd, robot: &Path) -> Result<Vec<Row>> {
    let pulled = scratch.path("pulled");
    let synced = scratch.path("synced");
    let runtime_dir = scratch.path("xdg");
    fs::create_dir_all(&runtime_dir)?;
    let shared: Vec<String> = over::shared_connection(sshd);
    let shared_options: Vec<&str> = shared.iter().map(String::as_str).collect();
    let mut rows = Vec::new();
    for (what, more, reuses, connection) in [
        (
            "",
            NO_OPTIONS,
            true,
            "pull-buffer reuses the connection that the pull before left open for a minute",
        ),
        (
            ", new connection each time",
            NO_OPTIONS,
            false,
            "most of pull-buffer's time is ssh's handshake",
        ),
        (", shared connection", &shared_options[..], false, "both use ssh's ControlMaster"),
    ] {
        for comparison in [Comparison::SizeAndTime, Comparison::Checksum] {
            let pull = || {
                let mut command = over::pull(sshd, more, programs, robot, &pulled);
                if reuses {
                    command.env("XDG_RUNTIME_DIR", &runtime_dir);
                }
                run(command)
            };
            let rsync = || run(over::rsync(sshd, more, comparison, robot, &synced));
            pull()?;
            rsync()?;
            let (ours, theirs) = both(RUNS, pull, rsync)?;
            let row = Row::seconds(AREA, format!("pull 1 GiB over ssh, nothing new{what}"), ours);
            let compared = match comparison {
                Comparison::SizeAndTime => "rsync sizes and times",
                Comparison::Checksum => "rsync reads and hashes all files on both sides",
            };
            rows.push(
                row.peer(comparison.name(), theirs.median).note(format!(
                    "pull-buffer compares names and sizes, {compared}; {connection}"
                )),
            );
        }
    }
    let mut exit = over::ssh(sshd);
    exit.args(shared).args(["-O", "exit"]).stderr(Stdio::null());
    run(exit)?;
    Ok(rows)
}

/// Measures both with alternating runs, and returns the first error of either.
fn both(
    runs: usize,
    mut ours: impl FnMut() -> Result<()>,
    mut peer: impl FnMut() -> Result<()>,
) -> Result<(Timing, Timing)> {
    let mut first = Ok(());
    let mut second = Ok(());
    let timings = time_against(
        runs,
        || first = std::mem::replace(&mut first, Ok(())).and_then(|()| ours()),
        || second = std::mem::replace(&mut second, Ok(())).and_then(|()| peer()),
    );
    first.and(second).map(|()| timings)
}

fn run(mut command: Command) -> Result<()> {
    let status = command.stdin(Stdio::null()).status().with_context(|| format!("{command:?}"))?;
    ensure!(status.success(), "{command:?}: {status}");
    Ok(())
}

/// Runs a command and returns its peak resident memory in MiB, from /proc while it runs.
fn run_measured(mut command: Command) -> Result<f64> {
    let mut child = command.stdin(Stdio::null()).spawn().with_context(|| format!("{command:?}"))?;
    let status_file = format!("/proc/{}/status", child.id());
    let mut peak_kib = 0.0_f64;
    let mut clock = monotonic_clock::MonotonicClock;
    loop {
        let status = fs::read_to_string(&status_file).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib =
            line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0.0);
        peak_kib = peak_kib.max(kib);
        if let Some(status) = child.try_wait()? {
            ensure!(status.success(), "{command:?}: {status}");
            return Ok(peak_kib / 1024.0);
        }
        let deadline_ns = hal::Clock::now_ns(&clock) + 10_000_000;
        hal::Clock::sleep_until_ns(&mut clock, deadline_ns);
    }
}

/// A folder that is removed when it is dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self> {
        let dir = std::env::temp_dir().join(format!("bench-data-{}", std::process::id()));
        fs::create_dir_all(&dir)?;
        Ok(Self(dir))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
