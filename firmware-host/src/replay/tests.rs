//! Tests of replay with a robot whose decisions are a digest of all its inputs, so that any change of a recording changes
//! them.

use std::path::Path;

use runtime::recording::{RecordedTick, Views, input_digest};
use runtime::tick::Decision;
use tempfile::TempDir;

use super::*;
use crate::record::tests::{run_header, some_tick};
use crate::record::{Recorder, RecorderOptions, segment_name};

#[derive(Default)]
struct DigestRobot {
    memory: u64,
}

impl Replayable for DigestRobot {
    fn hand_over(&mut self, _tick: u64) {}

    fn restore(&mut self, snapshot: &[u8]) -> anyhow::Result<()> {
        let bytes = snapshot.get(4..12).and_then(|bytes| bytes.try_into().ok());
        self.memory = u64::from_le_bytes(bytes.ok_or_else(|| anyhow::anyhow!("cut"))?);
        Ok(())
    }

    fn snapshot(&self) -> Vec<u8> {
        [&SNAPSHOT_VERSION.to_le_bytes()[..], &self.memory.to_le_bytes()].concat()
    }

    fn step(&mut self, tick: &RecordedTick) -> anyhow::Result<Decision> {
        let input = &tick.input()?;
        self.memory =
            (self.memory.rotate_left(9) ^ input_digest(input)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let digest = self.memory;
        let mut decision = some_tick(input.tick).decision.unwrap();
        decision.depth_digest = digest;
        decision.map_digest = digest.rotate_left(7);
        decision.desired.linear_mps = digest as f64 / u64::MAX as f64 / 3.0;
        Ok(decision)
    }
}

fn input_of(tick: u64) -> RecordedTick {
    let geometry = hal::ScanGeometry { beams: 3, ..hal::ScanGeometry::UTM_30LX };
    let ranges = vec![hal::Range::Hit(1.25), hal::Range::NoReturn, hal::Range::TooNear];
    let scan = hal::LaserScan { time_ns: tick, geometry, ranges };
    RecordedTick { scan: Some(scan), decision: None, ..some_tick(tick) }
}

/// A run of `ticks` ticks in segments of two seconds (20 ticks).
fn recorded(ticks: u64) -> TempDir {
    recorded_with_snapshots(ticks, u64::MAX)
}

fn recorded_with_snapshots(ticks: u64, snapshot_every: u64) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let options =
        RecorderOptions { segment_ns: 2_000_000_000, ..RecorderOptions::simulation(dir.path()) };
    let mut recorder = Recorder::start(options, run_header()).unwrap();
    let mut robot = DigestRobot::default();
    for tick in 0..ticks {
        let input = input_of(tick);
        let snapshot = (tick > 0 && tick.is_multiple_of(snapshot_every)).then(|| robot.snapshot());
        let decision = robot.step(&input).unwrap();
        recorder
            .record(RecordedTick { decision: Some(decision), snapshot, ..input }, Views::default())
            .unwrap();
    }
    recorder.finish().unwrap();
    dir
}

fn replayed(path: &Path) -> (ReplayReport, String) {
    replayed_span(path, Span::default())
}

fn replayed_span(path: &Path, span: Span) -> (ReplayReport, String) {
    let mut out = Vec::new();
    let report = replay(path, span, |_| Ok(Box::new(DigestRobot::default())), &mut out).unwrap();
    (report, String::from_utf8(out).unwrap())
}

fn refused(path: &Path) -> String {
    let error = replay(
        path,
        Span::default(),
        |_| Ok(Box::new(DigestRobot::default())),
        &mut std::io::sink(),
    )
    .unwrap_err();
    error.to_string()
}

#[test]
fn a_run_over_several_segments_replays_exactly() {
    let dir = recorded(50);
    assert!(dir.path().join(segment_name(2)).exists());
    let (report, out) = replayed(dir.path());
    assert!(report.is_exact(), "{out}");
    assert_eq!(out, "replay: ticks=50 mismatches=0\n");
}

#[test]
fn the_first_segment_alone_replays() {
    let dir = recorded(50);
    let (report, out) = replayed(&dir.path().join(segment_name(0)));
    assert!(report.is_exact(), "{out}");
    assert_eq!(report.ticks, 20);
}

#[test]
fn one_changed_input_is_found_wherever_it_is() {
    type Edit = fn(&mut RecordedTick);
    let edits: [(&str, Edit); 5] = [
        ("wheel", |tick| tick.wheel.odom.x_m += 1e-9),
        ("sign of zero", |tick| tick.wheel.odom.y_m = -0.0),
        ("pixel", |tick| tick.frame.as_mut().unwrap().rgb[100] ^= 1),
        ("beam", |tick| tick.scan.as_mut().unwrap().ranges[1] = hal::Range::TooNear),
        ("no scan", |tick| tick.scan = None),
    ];
    let original = recorded(50);
    for (name, edit) in edits {
        let dir = tempfile::tempdir().unwrap();
        let changed = dir.path().join("changed");
        rewrite(original.path(), &changed, |tick| {
            if tick.tick == 33 {
                edit(tick);
            }
        })
        .unwrap();
        let (report, out) = replayed(&changed);
        // The digest covers all earlier inputs, so every tick from the changed one on differs.
        assert_eq!((report.ticks, report.mismatches), (50, 17), "{name}: {out}");
        assert!(out.starts_with("tick 33 at 3.300 s: the decision differs:\n"), "{out}");
        assert!(out.contains("\n  desired.linear_mps: recorded 0."), "{out}");
        assert!(
            out.contains("... and 14 more ticks\n")
                && out.ends_with("replay: ticks=50 mismatches=17\n"),
            "{out}"
        );
        assert!(!report.is_exact());
    }
}

#[test]
fn a_copy_without_changes_replays_exactly() {
    let dir = tempfile::tempdir().unwrap();
    let copy = dir.path().join("copy");
    rewrite(recorded(30).path(), &copy, |_| {}).unwrap();
    assert!(replayed(&copy).0.is_exact());
}

#[test]
fn a_truncated_run_is_replayed_as_far_as_it_goes_and_is_not_exact() {
    let dir = recorded(50);
    let last = dir.path().join(segment_name(2));
    let bytes = std::fs::read(&last).unwrap();
    std::fs::write(&last, &bytes[..bytes.len() - 20]).unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!((report.ticks, report.mismatches), (50, 0));
    assert!(!report.is_exact() && report.problem.as_ref().unwrap().is_truncation());
    assert!(out.contains("recording_0002.mcap: truncated after tick 49"), "{out}");
    assert!(out.ends_with("replay: ticks=50 mismatches=0\n"), "{out}");
}

#[test]
fn a_corrupt_chunk_is_found_by_its_checksum_and_ends_the_replay() {
    let dir = recorded(20);
    let path = dir.path().join(segment_name(0));
    let mut bytes = std::fs::read(&path).unwrap();
    // In the middle of the images, which are most of the file.
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    std::fs::write(&path, bytes).unwrap();
    let (report, out) = replayed(&path);
    assert!(!report.is_exact() && report.mismatches == 0 && report.ticks < 20, "{out}");
    assert!(out.contains("recording_0000.mcap: corrupt"), "{out}");
}

#[test]
fn a_later_segment_alone_says_that_it_needs_the_run() {
    let dir = recorded(50);
    let message = refused(&dir.path().join(segment_name(1)));
    assert!(message.contains("segment 1") && message.contains("directory"), "{message}");
    std::fs::remove_file(dir.path().join(segment_name(0))).unwrap();
    assert!(refused(dir.path()).contains("segment 1"));
}

#[test]
fn a_missing_segment_in_the_middle_is_named() {
    let dir = recorded(50);
    std::fs::remove_file(dir.path().join(segment_name(1))).unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!(report.ticks, 20);
    assert!(out.contains("segment 2 where segment 1 should be"), "{out}");
}

#[test]
fn a_segment_of_another_run_is_named() {
    let dir = recorded(30);
    let other = tempfile::tempdir().unwrap();
    let options = RecorderOptions { segment_ns: 1, ..RecorderOptions::simulation(other.path()) };
    let header = runtime::recording::RunHeader { seed: 8, ..run_header() };
    let mut recorder = Recorder::start(options, header).unwrap();
    for tick in 0..3 {
        recorder.record(some_tick(tick), Views::default()).unwrap();
    }
    recorder.finish().unwrap();
    std::fs::copy(other.path().join(segment_name(1)), dir.path().join(segment_name(1))).unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!(report.ticks, 20);
    assert!(out.contains("belongs to another run"), "{out}");
}

#[test]
fn a_segment_that_begins_with_a_snapshot_replays_alone() {
    let dir = recorded_with_snapshots(50, 20);
    let (report, out) = replayed(&dir.path().join(segment_name(1)));
    assert!(report.is_exact(), "{out}");
    assert_eq!(
        out,
        "replaying from the snapshot of tick 20 at 2.000 s\nreplay: ticks=20 mismatches=0\n"
    );
}

#[test]
fn a_run_whose_first_segments_were_removed_replays_from_its_first_snapshot() {
    let dir = recorded_with_snapshots(60, 30);
    std::fs::remove_file(dir.path().join(segment_name(0))).unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!((report.ticks, report.unknown), (30, 10), "{out}");
    assert!(report.is_exact() && out.contains("10 ticks before the first snapshot"), "{out}");
}

#[test]
fn a_run_whose_first_segment_is_damaged_replays_from_a_later_moment_and_not_from_its_start() {
    let dir = recorded_with_snapshots(60, 20);
    let first = dir.path().join(segment_name(0));
    std::fs::write(&first, "no recording").unwrap();
    let span = Span { from: Some(Moment::Tick(40)), until_mismatch: false };
    let (report, out) = replayed_span(dir.path(), span);
    assert_eq!((report.ticks, report.mismatches), (20, 0), "{out}");
    assert!(refused(dir.path()).contains("recording_0000.mcap"));
}

#[test]
fn where_ticks_are_missing_the_replay_goes_on_at_the_next_snapshot_and_is_not_exact() {
    let dir = recorded_with_snapshots(60, 20);
    std::fs::remove_file(dir.path().join(segment_name(1))).unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!((report.ticks, report.mismatches), (40, 0), "{out}");
    assert!(!report.is_exact() && out.contains("segment 2 where segment 1 should be"), "{out}");
}

#[test]
fn a_replay_may_begin_at_any_tick_or_time_and_takes_the_snapshot_before_it() {
    let dir = recorded_with_snapshots(60, 20);
    for (from, first) in
        [("0", 0), ("19", 0), ("20", 20), ("39", 20), ("59", 40), ("1.9s", 0), ("2s", 20)]
    {
        let span = Span { from: Some(from.parse().unwrap()), until_mismatch: false };
        let (report, out) = replayed_span(dir.path(), span);
        assert_eq!((report.ticks, report.mismatches), (60 - first, 0), "{from}: {out}");
    }
    for beyond in ["60", "999", "99s"] {
        let span = Span { from: Some(beyond.parse().unwrap()), until_mismatch: false };
        let replayed = replay(
            dir.path(),
            span,
            |_| Ok(Box::new(DigestRobot::default())),
            &mut std::io::sink(),
        );
        let error = replayed.unwrap_err().to_string();
        assert!(error.contains("its last tick is 59"), "{beyond}: {error}");
    }
    for nonsense in ["", "x", "-1", "nans", "infs", "-1s", "1.5"] {
        assert!(nonsense.parse::<Moment>().is_err(), "{nonsense}");
    }
}

#[test]
fn until_mismatch_ends_at_the_first_tick_that_decides_differently() {
    let original = recorded(50);
    let dir = tempfile::tempdir().unwrap();
    let changed = dir.path().join("changed");
    rewrite(original.path(), &changed, |tick| {
        tick.wheel.odom.x_m += if tick.tick == 33 { 1e-9 } else { 0.0 }
    })
    .unwrap();
    let (report, out) = replayed_span(&changed, Span { from: None, until_mismatch: true });
    assert_eq!((report.ticks, report.mismatches), (34, 1), "{out}");
}

#[test]
fn a_memory_that_differs_is_found_although_the_decision_is_the_same() {
    let original = recorded_with_snapshots(50, 20);
    let dir = tempfile::tempdir().unwrap();
    let changed = dir.path().join("changed");
    rewrite(original.path(), &changed, |tick| {
        if let Some(snapshot) = tick.snapshot.as_mut().filter(|_| tick.tick == 40) {
            snapshot[5] ^= 1;
        }
    })
    .unwrap();
    let (report, out) = replayed(&changed);
    assert_eq!(report.mismatches, 1, "{out}");
    assert!(out.contains("tick 40") && out.contains("snapshot: recorded one memory"), "{out}");
}

#[test]
fn dropped_ticks_end_the_replay_with_their_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::start(RecorderOptions::simulation(dir.path()), run_header()).unwrap();
    for tick in [0, 1, 5] {
        recorder.record(input_of(tick), Views::default()).unwrap();
    }
    recorder.finish().unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!(report.ticks, 2);
    assert!(out.contains("tick 5 is where tick 2 should be"), "{out}");
}

#[test]
fn a_tick_without_a_recorded_decision_is_a_mismatch() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::start(RecorderOptions::simulation(dir.path()), run_header()).unwrap();
    recorder.record(input_of(0), Views::default()).unwrap();
    recorder.finish().unwrap();
    let (report, out) = replayed(dir.path());
    assert_eq!(report.mismatches, 1);
    assert!(out.contains("decision: recorded nothing"), "{out}");
}

#[test]
fn a_run_without_ticks_is_not_exact() {
    let dir = recorded(0);
    let (report, out) = replayed(dir.path());
    assert!(!report.is_exact());
    assert!(
        out.contains("has no ticks") && out.ends_with("replay: ticks=0 mismatches=0\n"),
        "{out}"
    );
}

#[test]
fn a_path_without_a_run_is_refused_with_its_name_and_a_way_out() {
    let dir = tempfile::tempdir().unwrap();
    let message = refused(dir.path());
    assert!(
        message.contains("holds no recording_NNNN.mcap") && message.contains("--out"),
        "{message}"
    );
    let missing = refused(&dir.path().join("gone"));
    assert!(missing.contains("gone") && missing.contains("--out"), "{missing}");
    for (name, bytes) in [("text.mcap", &b"this is not an MCAP file"[..]), ("empty.mcap", b"")] {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        assert!(refused(&path).contains(name));
    }
}

#[test]
fn a_loop_that_cannot_be_built_is_an_error() {
    let dir = recorded(1);
    let error =
        replay(dir.path(), Span::default(), |_| anyhow::bail!("no model"), &mut std::io::sink())
            .unwrap_err();
    assert_eq!(error.to_string(), "no model");
}
