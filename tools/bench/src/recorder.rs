//! Processor time of recording: frames of 640x480 at 30 Hz and scans of 1081 beams at 40 Hz, in real time on this disk. The
//! peer is the `mcap` crate's writer with default options, which writes the raw bytes of the same data.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Result;
use firmware_host::record::{Recorder, RecorderOptions};
use hal::{CameraModel, Clock, DepthMap, LaserScan, Range, ScanGeometry};
use monotonic_clock::MonotonicClock;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use runtime::recording::{RecordedTick, RgbImage, RunHeader, Views};
use rustix::time::{ClockId, clock_gettime};
use simulator::nuisance::Nuisances;
use simulator::render::{Lighting, Renderer};

use crate::report::{Row, Timing};
use crate::simulator::{hall, view};

const AREA: &str = "data";
/// Ticks per second, one for each scan; three of four have a frame.
const TICKS_HZ: u64 = 40;
const SECONDS: u64 = 10;
const SIZE: (usize, usize) = (640, 480);
/// Number of different frames, which are repeated: no writer compares one with another.
const IMAGES: usize = 12;

/// Measures the recorder.
///
/// # Errors
/// When the disk cannot be written.
pub fn rows() -> Result<Vec<Row>> {
    let ticks = ticks();
    let dir = tempfile::tempdir()?;
    let mut ours = Vec::new();
    let mut theirs = Vec::new();
    let mut dropped = 0;
    let mut bytes = (0, 0);
    for run in 0..3 {
        let before_s = processor_s();
        let summary = record(&ticks, &dir.path().join(run.to_string()))?;
        ours.push((processor_s() - before_s) / SECONDS as f64);
        dropped += summary.dropped;
        bytes.0 = summary.bytes;
        let before_s = processor_s();
        let path = dir.path().join(format!("{run}.mcap"));
        write_plainly(&ticks, &path)?;
        theirs.push((processor_s() - before_s) / SECONDS as f64);
        bytes.1 = path.metadata()?.len();
    }
    let note = format!(
        "{dropped} ticks dropped; synced every second; {:.0} MiB per minute, peer {:.0}, not synced",
        mib_per_minute(bytes.0),
        mib_per_minute(bytes.1)
    );
    let row = Row::seconds(
        AREA,
        "recorder: processor time per second, 30 Hz 640x480, 40 Hz scans",
        Timing::of(ours),
    );
    Ok(vec![
        row.peer("mcap's writer with default options, raw frames", Timing::of(theirs).median)
            .goal(0.15, 0.075)
            .note(note),
    ])
}

fn mib_per_minute(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20) * 60.0 / SECONDS as f64
}

/// Processor time of this process on all cores, seconds.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// The ticks of one second, with frames of a furnished hall and sensor noise.
fn ticks() -> Vec<RecordedTick> {
    let scene = hall();
    let renderer = Renderer::new(&scene);
    let camera = camera();
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    let images: Vec<RgbImage> = (0..IMAGES)
        .map(|index| {
            renderer.render(&camera, &view(index), &[], &Lighting::default(), &mut rgb, &mut depth);
            Nuisances::default().add_sensor_noise(&mut random, &mut rgb);
            RgbImage { width: SIZE.0, height: SIZE.1, rgb: rgb.clone() }
        })
        .collect();
    let geometry = ScanGeometry::UTM_30LX;
    (0..TICKS_HZ)
        .map(|tick| {
            let ranges = (0..geometry.beams)
                .map(|beam| Range::Hit(1.0 + (beam as u64 * 7919 % 20_000 + tick) as f32 * 1e-3));
            let scan = LaserScan { time_ns: 0, geometry, ranges: ranges.collect() };
            let frame = (tick % 4 != 0).then(|| images[tick as usize % IMAGES].clone());
            RecordedTick { scan: Some(scan), frame, ..RecordedTick::new(tick, 0) }
        })
        .collect()
}

fn camera() -> CameraModel {
    CameraModel::pinhole(SIZE.0, SIZE.1, std::f64::consts::FRAC_PI_2)
}

/// Repeats the ticks in real time.
fn paced(ticks: &[RecordedTick], mut take: impl FnMut(RecordedTick) -> Result<()>) -> Result<()> {
    let mut clock = MonotonicClock;
    let start_ns = clock.now_ns();
    for (tick, recorded) in (0..SECONDS * TICKS_HZ).zip(ticks.iter().cycle()) {
        let time_ns = tick * (1_000_000_000 / TICKS_HZ);
        clock.sleep_until_ns(start_ns + time_ns);
        let mut recorded = RecordedTick { tick, time_ns, ..recorded.clone() };
        if let Some(scan) = &mut recorded.scan {
            scan.time_ns = time_ns;
        }
        take(recorded)?;
    }
    Ok(())
}

fn record(ticks: &[RecordedTick], dir: &Path) -> Result<firmware_host::record::RecordingSummary> {
    let mut recorder =
        Recorder::start(RecorderOptions::robot(dir), RunHeader::new("bench", camera()))?;
    paced(ticks, |tick| Ok(recorder.record(tick, Views::default())?))?;
    Ok(recorder.finish()?)
}

fn write_plainly(ticks: &[RecordedTick], path: &Path) -> Result<()> {
    let mut writer = mcap::Writer::new(BufWriter::new(File::create(path)?))?;
    let images = writer.add_channel(0, "/camera/image", "raw", &BTreeMap::new())?;
    let scans = writer.add_channel(0, "/scan", "raw", &BTreeMap::new())?;
    paced(ticks, |tick| {
        let scan_header = mcap::records::MessageHeader {
            channel_id: scans,
            sequence: tick.tick as u32,
            log_time: tick.time_ns,
            publish_time: tick.time_ns,
        };
        let ranges = tick.scan.iter().flat_map(|scan| &scan.ranges);
        let bytes: Vec<u8> =
            ranges.flat_map(|range| range.hit_m().unwrap_or(0.0).to_le_bytes()).collect();
        writer.write_to_known_channel(&scan_header, &bytes)?;
        if let Some(frame) = &tick.frame {
            let image_header = mcap::records::MessageHeader { channel_id: images, ..scan_header };
            writer.write_to_known_channel(&image_header, &Cow::Borrowed(&frame.rgb))?;
        }
        Ok(())
    })?;
    writer.finish()?;
    Ok(())
}
