//! Small recordings, and a server and a client connected by a socket.

use std::fs;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use hal::{CameraModel, Pose2, VirtualClock, WheelFeedback, camera_mount};
use runtime::event::Event;
use runtime::recording::{
    RecordedTick, RecordingWriter, RgbImage, RunHeader, SegmentHeader, Views,
};
use runtime::tick::{Command, Decision};
use segment_store::pull::{Destination, FileSystem, Options, Progress, Report, pull};
use segment_store::source::{Remote, Source};
use segment_store::{CpuFeatures, Root, StoreError};

/// The number of ticks in a chunk: there are ten per second, and a chunk is closed after one second.
pub const CHUNK_TICKS: u64 = 11;

pub fn run_header() -> RunHeader {
    RunHeader {
        seed: 7,
        t_base_camera: camera_mount(0.1, 0.8, 0.2),
        ..RunHeader::new("test 0.0.0", CameraModel::pinhole(16, 12, 1.5))
    }
}

/// Random numbers (SplitMix64), which do not compress.
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }
}

pub fn some_tick(tick: u64) -> RecordedTick {
    let time_ns = tick * 100_000_000;
    let mut noise = Noise(tick);
    let odom = Pose2::new(0.03 * tick as f64, 0.0, 0.01 * tick as f64);
    RecordedTick {
        wheel: WheelFeedback { time_ns, odom, ..WheelFeedback::default() },
        frame: Some(RgbImage {
            width: 16,
            height: 12,
            rgb: (0..16 * 12 * 3).map(|_| noise.next() as u8).collect(),
        }),
        ..RecordedTick::new(tick, time_ns)
    }
}

/// The decision of a robot that stands at the start.
pub fn decision(tick: u64, events: Vec<Event>) -> Decision {
    Decision {
        tick,
        time_ns: tick * 100_000_000,
        desired: Command::default(),
        sent: None,
        goal_m: Some([1.5, -2.0]),
        t_odom_base: Pose2::IDENTITY,
        t_odom_base_at_frame: Pose2::IDENTITY,
        t_map_odom: Pose2::IDENTITY,
        lost: None,
        events,
        input_digest: 0,
        depth_digest: 0,
        map_digest: 0,
    }
}

/// A whole segment.
pub fn segment(number: u32, first_tick: u64, ticks: u64) -> Vec<u8> {
    let header = SegmentHeader::new(run_header(), number, first_tick, first_tick * 100_000_000);
    let mut writer = RecordingWriter::begin(Vec::new(), header).unwrap();
    for tick in first_tick..first_tick + ticks {
        writer.write(&some_tick(tick), &Views::default()).unwrap();
    }
    writer.finish().map_err(|(_, error)| error).unwrap()
}

/// Creates a store with two runs: segments of 30, 30 and 20 ticks, and one of 15.
pub fn robot(dir: &Path) {
    for (run, number, first, ticks) in
        [("monday", 0, 0, 30), ("monday", 1, 30, 30), ("monday", 2, 60, 20), ("tuesday", 0, 0, 15)]
    {
        fs::create_dir_all(dir.join(run)).unwrap();
        fs::write(
            dir.join(run).join(format!("recording_{number:04}.mcap")),
            segment(number, first, ticks),
        )
        .unwrap();
    }
    // Files that are not segments of a run must be ignored.
    fs::write(dir.join("monday/summary.json"), "{}").unwrap();
    fs::create_dir_all(dir.join("monday/more")).unwrap();
    fs::write(dir.join("monday/more/recording_0000.mcap"), segment(0, 0, 3)).unwrap();
}

pub const FILES: [&str; 4] = [
    "monday/recording_0000.mcap",
    "monday/recording_0001.mcap",
    "monday/recording_0002.mcap",
    "tuesday/recording_0000.mcap",
];

pub fn assert_same(robot: &Path, here: &Path, files: &[&str]) {
    for file in files {
        assert!(
            fs::read(robot.join(file)).unwrap() == fs::read(here.join(file)).unwrap(),
            "{file} differs"
        );
        assert!(!here.join(format!("{file}.part")).exists(), "{file}.part was left behind");
    }
}

/// Connects to a server for `dir`, which ends with the connection.
pub fn connect(dir: &Path) -> Remote<UnixStream, UnixStream> {
    let (ours, theirs) = UnixStream::pair().unwrap();
    serve_on(dir, theirs);
    ours.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    Remote::greet("robot", ours.try_clone().unwrap(), ours, 30).unwrap()
}

pub fn serve_on(dir: &Path, mut stream: UnixStream) {
    let root = Root::open(dir).unwrap();
    let mut input = stream.try_clone().unwrap();
    // The error when the client closes the connection is expected.
    std::thread::spawn(move || {
        drop(segment_store::serve(
            &root,
            CpuFeatures { aes: true },
            &mut |_| (),
            &mut input,
            &mut stream,
        ));
    });
}

pub fn pull_into(
    source: &mut dyn Source,
    here: &Path,
    options: Options,
) -> Result<Report, StoreError> {
    pull_with_progress(source, here, options, &mut ())
}

pub fn pull_with_progress(
    source: &mut dyn Source,
    here: &Path,
    options: Options,
    progress: &mut dyn Progress,
) -> Result<Report, StoreError> {
    let mut destination = Destination::open(here, &FileSystem)?;
    pull(source, &mut destination, &options, &mut VirtualClock::default(), progress)
}
