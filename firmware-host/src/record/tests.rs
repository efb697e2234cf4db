//! Tests of the recorder on disks that are full, stall or fail.

use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};

use hal::CameraModel;
use runtime::recording::{RecordedTick, RecordingReader, RgbImage, RunHeader, RunIdentity, Views};
use runtime::tick::{Command, Decision};
use segment_store::signature::RobotKey;
use segment_store::{Finding, Signed, check_signature, verify};

use super::*;

pub(crate) fn run_header() -> RunHeader {
    RunHeader { seed: 7, ..RunHeader::new("test 0.0.0", CameraModel::pinhole(32, 8, 1.5)) }
}

/// A tick of a 10 Hz run with an image that does not compress.
pub(crate) fn some_tick(tick: u64) -> RecordedTick {
    let mut state = tick.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let bytes = (0..32 * 8 * 3).map(|_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    });
    let frame = RgbImage { width: 32, height: 8, rgb: bytes.collect() };
    let time_ns = tick * 100_000_000;
    let decision = Decision {
        tick,
        time_ns,
        desired: Command { linear_mps: 0.3, angular_radps: 0.0 },
        sent: Some(Command { linear_mps: 0.3, angular_radps: 0.1 }),
        goal_m: Some([1.0, 2.0]),
        t_odom_base: hal::Pose2::IDENTITY,
        t_odom_base_at_frame: hal::Pose2::IDENTITY,
        t_map_odom: hal::Pose2::IDENTITY,
        lost: None,
        events: Vec::new(),
        input_digest: 3,
        depth_digest: tick,
        map_digest: 0,
    };
    RecordedTick {
        frame: Some(frame),
        decision: Some(decision),
        ..RecordedTick::new(tick, time_ns)
    }
}

/// Ticks of all segments in the directory. Every segment must be a complete file.
fn read_all(dir: &Path) -> Vec<RecordedTick> {
    let mut names: Vec<_> =
        std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.sort();
    let mut ticks = Vec::new();
    for (number, name) in names.iter().enumerate() {
        let reader = RecordingReader::open(std::fs::File::open(name).unwrap()).unwrap();
        assert_eq!(reader.header().segment as usize, number);
        ticks.extend(
            reader.map(|tick| tick.unwrap_or_else(|error| panic!("{}: {error}", name.display()))),
        );
    }
    ticks
}

fn record(options: RecorderOptions, ticks: u64) -> RecordingSummary {
    let mut recorder = Recorder::start(options, run_header()).unwrap();
    for tick in 0..ticks {
        recorder.record(some_tick(tick), Views::default()).unwrap();
    }
    recorder.finish().unwrap()
}

#[test]
fn the_recording_of_a_robot_is_for_its_account_only() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("runs/monday");
    record(RecorderOptions { segment_ns: 2_000_000_000, ..RecorderOptions::robot(&run) }, 15);
    assert_eq!(mode(&run), 0o700);
    for segment in std::fs::read_dir(&run).unwrap() {
        let path = segment.unwrap().path();
        assert_eq!(mode(&path), 0o600, "{}", path.display());
    }
}

fn mode(path: &Path) -> u32 {
    path.metadata().unwrap().permissions().mode() & 0o777
}

#[test]
fn a_run_is_split_by_time_and_nothing_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let options =
        RecorderOptions { segment_ns: 2_000_000_000, ..RecorderOptions::simulation(dir.path()) };
    let summary = record(options, 50);
    assert_eq!((summary.ticks, summary.segments, summary.dropped), (50, 3, 0));
    assert_eq!(read_all(dir.path()), (0..50).map(some_tick).collect::<Vec<_>>());
}

#[test]
fn each_segment_of_a_robot_with_a_key_is_signed_and_names_the_one_before_it() {
    let dir = tempfile::tempdir().unwrap();
    let key = RobotKey::new(&[7; 32]);
    let options = RecorderOptions {
        segment_ns: 2_000_000_000,
        key: Some(key.clone()),
        ..RecorderOptions::simulation(dir.path())
    };
    let identity = RunIdentity {
        run: "0123456789abcdef0123456789abcdef".to_owned(),
        robot: Some(key.public()),
        name: String::new(),
        site: String::new(),
        boot: String::new(),
    };
    let header = RunHeader { identity: Some(identity.clone()), ..run_header() };
    let mut recorder = Recorder::start(options, header).unwrap();
    (0..50).for_each(|tick| recorder.record(some_tick(tick), Views::default()).unwrap());
    assert_eq!(recorder.finish().unwrap().segments, 3);
    let mut previous = String::new();
    for segment in 0..3 {
        let file = std::fs::File::open(dir.path().join(segment_name(segment))).unwrap();
        assert_eq!(verify(&file).unwrap().finding, Finding::Whole);
        let Signed::By(statement) = check_signature(&file).unwrap() else { panic!("{segment}") };
        assert_eq!((statement.segment, &statement.run), (segment, &identity.run));
        assert_eq!((statement.robot, statement.previous), (key.public(), previous));
        previous = statement.digest;
    }
    assert_eq!(read_all(dir.path()), (0..50).map(some_tick).collect::<Vec<_>>());
}

#[test]
fn a_run_is_split_by_size_and_its_digest_does_not_depend_on_that() {
    let small = tempfile::tempdir().unwrap();
    let large = tempfile::tempdir().unwrap();
    let cut = record(
        RecorderOptions { segment_bytes: 10_000, ..RecorderOptions::simulation(small.path()) },
        100,
    );
    let whole = record(RecorderOptions::simulation(large.path()), 100);
    assert!(cut.segments > 5, "{}", cut.segments);
    assert_eq!(whole.segments, 1);
    assert_eq!(
        (cut.inputs_digest, cut.decisions_digest),
        (whole.inputs_digest, whole.decisions_digest)
    );
    assert_eq!(read_all(small.path()), read_all(large.path()));
    let size: u64 = std::fs::read_dir(large.path())
        .unwrap()
        .map(|e| e.unwrap().metadata().unwrap().len())
        .sum();
    assert_eq!(whole.bytes, size);
}

#[test]
fn the_same_run_gives_the_same_files() {
    let a = tempfile::tempdir().unwrap();
    let b = tempfile::tempdir().unwrap();
    record(RecorderOptions::simulation(a.path()), 40);
    record(RecorderOptions::simulation(b.path()), 40);
    let one = std::fs::read(a.path().join(segment_name(0))).unwrap();
    let other = std::fs::read(b.path().join(segment_name(0))).unwrap();
    assert!(one == other);
}

#[test]
fn a_run_without_ticks_leaves_its_header() {
    let dir = tempfile::tempdir().unwrap();
    let summary = record(RecorderOptions::simulation(dir.path()), 0);
    assert_eq!((summary.ticks, summary.segments), (0, 1));
    assert!(read_all(dir.path()).is_empty());
}

#[test]
fn an_old_recording_is_never_written_over() {
    let dir = tempfile::tempdir().unwrap();
    record(RecorderOptions::simulation(dir.path()), 3);
    let before = std::fs::read(dir.path().join(segment_name(0))).unwrap();
    let error =
        Recorder::start(RecorderOptions::simulation(dir.path()), run_header()).err().unwrap();
    assert!(
        matches!(error, RecordError::HoldsRecording { .. }) && error.to_string().contains("--out"),
        "{error}"
    );
    assert_eq!(std::fs::read(dir.path().join(segment_name(0))).unwrap(), before);
}

#[test]
fn a_directory_that_cannot_be_made_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    std::fs::write(&file, "").unwrap();
    let error =
        Recorder::start(RecorderOptions::simulation(file.join("run")), run_header()).err().unwrap();
    assert!(error.to_string().contains("file/run"), "{error}");
}

/// A file system that holds at most `free` bytes in total.
struct SmallDisk {
    free: Arc<AtomicU64>,
}

struct SmallFile {
    file: Box<dyn SegmentFile>,
    len: u64,
    free: Arc<AtomicU64>,
}

impl Disk for SmallDisk {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
        Ok(Box::new(SmallFile {
            file: FileSystem.create(path)?,
            len: 0,
            free: Arc::clone(&self.free),
        }))
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        FileSystem.remove(path)
    }

    fn space(&self, path: &Path) -> io::Result<Space> {
        FileSystem.space(path)
    }
}

impl Write for SmallFile {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let free = self.free.load(Ordering::SeqCst);
        if free == 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let written = self.file.write(&data[..data.len().min(free as usize)])?;
        self.free.fetch_sub(written as u64, Ordering::SeqCst);
        self.len += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl SegmentFile for SmallFile {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.free.fetch_add(self.len - len, Ordering::SeqCst);
        self.len = len;
        self.file.truncate(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }
}

#[test]
fn a_disk_that_fills_ends_the_run_with_its_reason_and_leaves_only_whole_files() {
    let mut kept = Vec::new();
    // Fine steps, because there may be room for a whole chunk and none for the 37 bytes of the end.
    let steps = (0..30_000).step_by(1_777).chain((30_000..60_000).step_by(31));
    for free in steps.chain((60_000..90_000).step_by(1_777)) {
        let dir = tempfile::tempdir().unwrap();
        let options = RecorderOptions {
            segment_ns: 4_000_000_000,
            ..RecorderOptions::simulation(dir.path())
        };
        let disk = SmallDisk { free: Arc::new(AtomicU64::new(free)) };
        let mut recorder = Recorder::start_on(Box::new(disk), options, run_header()).unwrap();
        let failed =
            (0..200).find_map(|tick| recorder.record(some_tick(tick), Views::default()).err());
        let error = match failed {
            Some(error) => error,
            None => recorder.finish().unwrap_err(),
        };
        assert!(matches!(error, RecordError::Write { .. }), "{free}: {error}");
        let ticks = read_all(dir.path());
        assert_eq!(ticks, (0..ticks.len() as u64).map(some_tick).collect::<Vec<_>>(), "{free}");
        kept.push(ticks.len());
    }
    assert!(kept.is_sorted() && kept[0] == 0 && *kept.last().unwrap() > 60, "{kept:?}");
}

#[test]
fn a_tick_that_would_not_replay_ends_the_recording_and_keeps_the_ticks_before() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::start(RecorderOptions::simulation(dir.path()), run_header()).unwrap();
    for tick in 0..30 {
        recorder.record(some_tick(tick), Views::default()).unwrap();
    }
    let mut bad = some_tick(30);
    bad.decision.as_mut().unwrap().desired.linear_mps = f64::NAN;
    recorder.record(bad, Views::default()).unwrap();
    let error = recorder.finish().unwrap_err();
    assert!(
        matches!(error, RecordError::Content { .. }) && error.to_string().contains("tick 30"),
        "{error}"
    );
    assert_eq!(read_all(dir.path()).len(), 22);
}

/// A disk whose files wait for a permit before their first write.
struct StalledDisk {
    permit: Arc<Mutex<Receiver<()>>>,
    reached: SyncSender<()>,
}

struct StalledFile {
    file: Box<dyn SegmentFile>,
    permit: Arc<Mutex<Receiver<()>>>,
    reached: Option<SyncSender<()>>,
}

impl Disk for StalledDisk {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
        let file = FileSystem.create(path)?;
        let permit = Arc::clone(&self.permit);
        Ok(Box::new(StalledFile { file, permit, reached: Some(self.reached.clone()) }))
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        FileSystem.remove(path)
    }

    fn space(&self, path: &Path) -> io::Result<Space> {
        FileSystem.space(path)
    }
}

impl Write for StalledFile {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        if let Some(reached) = self.reached.take() {
            reached.send(()).map_err(io::Error::other)?;
            self.permit.lock().unwrap().recv().map_err(io::Error::other)?;
        }
        self.file.write(data)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl SegmentFile for StalledFile {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.file.truncate(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }
}

fn stalled() -> (StalledDisk, SyncSender<()>, Receiver<()>) {
    let (permit_sender, permit) = sync_channel(1);
    let (reached, reached_receiver) = sync_channel(1);
    (StalledDisk { permit: Arc::new(Mutex::new(permit)), reached }, permit_sender, reached_receiver)
}

#[test]
fn a_robot_drops_and_counts_what_a_stalled_disk_does_not_take() {
    let dir = tempfile::tempdir().unwrap();
    let (disk, permit, reached) = stalled();
    let options = RecorderOptions { queue_ticks: 4, ..RecorderOptions::robot(dir.path()) };
    let mut recorder = Recorder::start_on(Box::new(disk), options, run_header()).unwrap();
    recorder.record(some_tick(0), Views::default()).unwrap();
    reached.recv().unwrap();
    // The thread holds tick 0; four more fit into the queue.
    for tick in 1..20 {
        recorder.record(some_tick(tick), Views::default()).unwrap();
    }
    assert_eq!(recorder.dropped(), 15);
    permit.send(()).unwrap();
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.ticks, summary.dropped), (5, 15));
    assert_eq!(read_all(dir.path()), (0..5).map(some_tick).collect::<Vec<_>>());
}

/// Waits until the status of the recording thread satisfies `wanted`.
fn wait_for(recorder: &Recorder, wanted: impl Fn(&RecorderStatus) -> bool) {
    while !wanted(&recorder.status()) {
        std::thread::yield_now();
    }
}

/// Records a tick as the loop does, with a snapshot if the recorder wants one.
fn hand_over(recorder: &mut Recorder, tick: u64) {
    let mut tick = some_tick(tick);
    tick.snapshot = recorder.wants_snapshot(tick.time_ns).then(|| vec![1, 2, 3]);
    recorder.record(tick, Views::default()).unwrap();
}

#[test]
fn a_robot_reports_a_full_disk_goes_on_and_records_again_when_there_is_space() {
    let dir = tempfile::tempdir().unwrap();
    let free = Arc::new(AtomicU64::new(0));
    let disk = SmallDisk { free: Arc::clone(&free) };
    let options = RecorderOptions { queue_ticks: 1000, ..RecorderOptions::robot(dir.path()) };
    let mut recorder = Recorder::start_on(Box::new(disk), options, run_header()).unwrap();
    hand_over(&mut recorder, 0);
    wait_for(&recorder, |word| word.failure.is_some());
    assert!(recorder.status().failure.unwrap().contains("cannot write"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "nothing half-written is left");
    // There is still no space: the recorder tries again every ten seconds, 100 ticks.
    (1..250).for_each(|tick| hand_over(&mut recorder, tick));
    wait_for(&recorder, |word| word.lost == 250);
    free.store(u64::MAX / 2, Ordering::SeqCst);
    let mut tick = 250;
    while recorder.status().failure.is_some() {
        hand_over(&mut recorder, tick);
        tick += 1;
        wait_for(&recorder, |word| word.failure.is_none() || word.lost == tick);
    }
    assert!((300..=305).contains(&tick), "{tick}");
    (tick..tick + 5).for_each(|tick| hand_over(&mut recorder, tick));
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.failure, summary.dropped), (None, tick - 1));
    let ticks = read_all(dir.path());
    assert_eq!(ticks.len(), 6);
    assert!(ticks[0].snapshot.is_some(), "what comes then can be replayed");
}

#[test]
fn a_run_that_ends_while_nothing_is_recorded_reports_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let disk = SmallDisk { free: Arc::new(AtomicU64::new(0)) };
    let mut recorder =
        Recorder::start_on(Box::new(disk), RecorderOptions::robot(dir.path()), run_header())
            .unwrap();
    hand_over(&mut recorder, 0);
    wait_for(&recorder, |word| word.failure.is_some());
    let summary = recorder.finish().unwrap();
    assert!(summary.failure.unwrap().contains("free disk space"));
}

#[test]
fn without_images_no_part_that_contains_one_is_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let options = RecorderOptions { images: false, ..RecorderOptions::simulation(dir.path()) };
    let mut recorder = Recorder::start(options, run_header()).unwrap();
    let depth = hal::DepthMap::from_vec(2, 1, vec![1.0, 2.0]);
    let tick = RecordedTick { truth: depth.clone(), snapshot: Some(vec![9]), ..some_tick(0) };
    recorder.record(tick, Views { depth, ..Views::default() }).unwrap();
    recorder.finish().unwrap();
    let reader =
        RecordingReader::open(std::fs::File::open(dir.path().join(segment_name(0))).unwrap())
            .unwrap();
    assert!(!reader.header().run.images);
    let ticks: Vec<_> = reader.map(Result::unwrap).collect();
    assert!(ticks[0].frame.is_none() && ticks[0].truth.is_none() && ticks[0].snapshot.is_none());
    let bytes = std::fs::read(dir.path().join(segment_name(0))).unwrap();
    for topic in ["/camera/image", "/depth", "/camera/truth_depth", "/robot/snapshot"] {
        assert!(!bytes.windows(topic.len()).any(|window| window == topic.as_bytes()), "{topic}");
    }
}

#[test]
fn a_recorder_that_is_dropped_leaves_whole_files() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::start(RecorderOptions::simulation(dir.path()), run_header()).unwrap();
    for tick in 0..15 {
        recorder.record(some_tick(tick), Views::default()).unwrap();
    }
    drop(recorder);
    assert_eq!(read_all(dir.path()).len(), 15);
}

#[test]
fn a_cut_leaves_whole_files_while_the_run_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::start(RecorderOptions::simulation(dir.path()), run_header()).unwrap();
    for tick in 0..5 {
        recorder.record(some_tick(tick), Views::default()).unwrap();
    }
    assert_eq!(recorder.cut().unwrap(), 1);
    assert_eq!(read_all(dir.path()).len(), 5);
    assert_eq!(recorder.cut().unwrap(), 1, "nothing new, no new file");
    recorder.record(some_tick(5), Views::default()).unwrap();
    assert_eq!(recorder.cut().unwrap(), 2);
    assert_eq!(read_all(dir.path()).len(), 6);
    assert_eq!(recorder.finish().unwrap().ticks, 6);
}

/// A disk on which one operation fails, or all operations from it on.
#[derive(Clone)]
struct FailingDisk {
    /// Number of operations before the failure.
    left: Arc<AtomicU64>,
    error: io::ErrorKind,
    for_good: bool,
}

impl FailingDisk {
    fn operation(&self) -> io::Result<()> {
        let left = self.left.load(Ordering::SeqCst);
        let fails = left == 1 || (left == 0 && self.for_good);
        self.left.store(left.saturating_sub(1), Ordering::SeqCst);
        if fails { Err(self.error.into()) } else { Ok(()) }
    }
}

struct FailingFile {
    file: Box<dyn SegmentFile>,
    disk: FailingDisk,
}

impl Disk for FailingDisk {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
        self.operation()?;
        Ok(Box::new(FailingFile { file: FileSystem.create(path)?, disk: self.clone() }))
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        self.operation()?;
        FileSystem.remove(path)
    }

    fn space(&self, path: &Path) -> io::Result<Space> {
        self.operation()?;
        FileSystem.space(path)
    }
}

impl Write for FailingFile {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        self.disk.operation()?;
        self.file.write(data)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl SegmentFile for FailingFile {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.disk.operation()?;
        self.file.truncate(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        // Real syncing would take long, and this test has no power cut.
        self.disk.operation()
    }
}

/// The ticks of the folder's segments, complete or truncated. No segment may be corrupt.
fn ticks_on_disk(dir: &Path) -> Vec<RecordedTick> {
    let mut paths: Vec<_> =
        std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let mut ticks = Vec::new();
    for path in paths {
        match RecordingReader::open(std::fs::File::open(&path).unwrap()) {
            Ok(reader) => {
                for tick in reader {
                    match tick {
                        Ok(tick) => ticks.push(tick),
                        Err(error) => assert!(error.is_truncation(), "{}: {error}", path.display()),
                    }
                }
            }
            // Truncated before its first chunk, on a disk on which removing it failed as well.
            Err(error) => assert!(
                error.is_truncation() || std::fs::metadata(&path).unwrap().len() < 8,
                "{error}"
            ),
        }
    }
    ticks
}

#[test]
fn any_operation_of_the_disk_may_fail_and_the_robot_goes_on_and_its_recording_is_valid() {
    const TICKS: u64 = 130;
    let mut failed = 0;
    let errors =
        [io::ErrorKind::StorageFull, io::ErrorKind::Other, io::ErrorKind::ReadOnlyFilesystem];
    // The first operation is the creation of the first file, which ends the start.
    for (operation, error) in (2..34).zip(errors.into_iter().cycle()) {
        for for_good in [false, true] {
            let dir = tempfile::tempdir().unwrap();
            let disk = FailingDisk { left: Arc::new(AtomicU64::new(operation)), error, for_good };
            let quota = Quota {
                buffer: dir.path().to_owned(),
                bytes: None,
                free_bytes: 0,
                kept_percent: 50,
                max_age_days: 0,
            };
            let options = RecorderOptions {
                segment_ns: 4_000_000_000,
                queue_ticks: 1000,
                quota: Some(quota),
                ..RecorderOptions::robot(dir.path().join("run"))
            };
            let mut recorder = Recorder::start_on(Box::new(disk), options, run_header()).unwrap();
            for tick in 0..TICKS {
                hand_over(&mut recorder, tick);
                // As slow as a robot, or all ticks would be in the queue before the first failure.
                wait_for(&recorder, |word| word.taken == tick + 1);
            }
            let case = format!("{error:?} at operation {operation}, for good: {for_good}");
            let (lost, ticks) = match recorder.finish() {
                Ok(summary) => (summary.dropped, ticks_on_disk(&dir.path().join("run"))),
                // The last operation writes the index of the last segment. Its ticks are recorded.
                Err(_) => (0, ticks_on_disk(&dir.path().join("run"))),
            };
            assert!(ticks.iter().is_sorted_by_key(|tick| tick.tick), "{case}");
            assert!(
                ticks
                    .iter()
                    .all(|tick| RecordedTick { snapshot: None, ..tick.clone() }
                        == some_tick(tick.tick)),
                "{case}"
            );
            // A failure costs the chunk that was being written and the ticks before the next attempt.
            assert!(
                for_good || ticks.len() as u64 + lost + 11 >= TICKS,
                "{case}: {} ticks, {lost} lost",
                ticks.len()
            );
            assert!(for_good || ticks.len() >= 15, "{case}: {}", ticks.len());
            failed += u64::from(lost > 0);
        }
    }
    assert!(failed > 20, "{failed}");
}

#[test]
fn a_directory_that_cannot_be_written_ends_the_start_with_a_way_out() {
    let dir = tempfile::tempdir().unwrap();
    let disk = FailingDisk {
        left: Arc::new(AtomicU64::new(1)),
        error: io::ErrorKind::ReadOnlyFilesystem,
        for_good: true,
    };
    let error =
        Recorder::start_on(Box::new(disk), RecorderOptions::robot(dir.path()), run_header())
            .err()
            .unwrap();
    assert!(
        matches!(error, RecordError::Create { .. }) && error.to_string().contains("--out"),
        "{error}"
    );
}
