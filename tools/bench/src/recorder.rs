//! What recording costs: frames of 640x480 at 30 Hz and scans of 1081 beams at 40 Hz, in real time on this disk. The peer is the
//! `mcap` crate's writer as it comes, given the raw bytes of the same.

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
use runtime::recording::{Picture, RecordedTick, RunHeader, Views};
use rustix::time::{ClockId, clock_gettime};
use simulator::nuisance::Nuisances;
use simulator::render::{Lighting, Renderer};

use crate::report::{Row, Timing};
use crate::simulator::{hall, view};

const ROOM: &str = "data";
/// Turns a second: as many as scans; three of four have a frame.
const TURNS_HZ: u64 = 40;
const SECONDS: u64 = 10;
const SIZE: (usize, usize) = (640, 480);
/// Different frames, again and again: no writer compares one with another.
const IMAGES: usize = 12;

/// Measures the recorder.
///
/// # Errors
/// When the disk cannot be written.
pub fn rows() -> Result<Vec<Row>> {
    let turns = turns();
    let dir = tempfile::tempdir()?;
    let mut ours = Vec::new();
    let mut theirs = Vec::new();
    let mut dropped = 0;
    let mut bytes = (0, 0);
    for run in 0..3 {
        let before_s = processor_s();
        let summary = record(&turns, &dir.path().join(run.to_string()))?;
        ours.push((processor_s() - before_s) / SECONDS as f64);
        dropped += summary.dropped;
        bytes.0 = summary.bytes;
        let before_s = processor_s();
        let path = dir.path().join(format!("{run}.mcap"));
        write_plainly(&turns, &path)?;
        theirs.push((processor_s() - before_s) / SECONDS as f64);
        bytes.1 = path.metadata()?.len();
    }
    let mib_a_minute = |bytes: u64| bytes as f64 / f64::from(1 << 20) * 60.0 / SECONDS as f64;
    let note = format!(
        "{dropped} turns dropped; synced every second; {:.0} MiB a minute, peer {:.0}, not synced",
        mib_a_minute(bytes.0),
        mib_a_minute(bytes.1)
    );
    let row = Row::seconds(
        ROOM,
        "recorder: processor time of a second, 30 Hz 640x480, 40 Hz scans",
        Timing::of(ours),
    );
    Ok(vec![
        row.peer("mcap's writer as it comes, raw pictures", Timing::of(theirs).median)
            .goal(0.15, 0.075)
            .note(note),
    ])
}

/// Of this process on all cores, seconds.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A second's turns, as a camera in a furnished hall gives them, with a sensor's noise.
fn turns() -> Vec<RecordedTick> {
    let scene = hall();
    let renderer = Renderer::new(&scene);
    let camera = camera();
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut rgb = Vec::new();
    let mut depth = DepthMap::none(0, 0);
    let images: Vec<Picture> = (0..IMAGES)
        .map(|index| {
            renderer.render(&camera, &view(index), &[], &Lighting::default(), &mut rgb, &mut depth);
            Nuisances::default().add_sensor_noise(&mut random, &mut rgb);
            Picture { width: SIZE.0, height: SIZE.1, rgb: rgb.clone() }
        })
        .collect();
    let geometry = ScanGeometry::UTM_30LX;
    (0..TURNS_HZ)
        .map(|turn| {
            let range =
                |beam: usize| Range::Hit(1.0 + (beam as u64 * 7919 % 20_000 + turn) as f32 * 1e-3);
            let scan = LaserScan {
                time_ns: 0,
                geometry,
                ranges: (0..geometry.beams).map(range).collect(),
            };
            let frame = (turn % 4 != 0).then(|| images[turn as usize % IMAGES].clone());
            RecordedTick { scan: Some(scan), frame, ..RecordedTick::new(turn, 0) }
        })
        .collect()
}

fn camera() -> CameraModel {
    CameraModel::pinhole(SIZE.0, SIZE.1, std::f64::consts::FRAC_PI_2)
}

/// The turns again and again at their pace.
fn paced(turns: &[RecordedTick], mut take: impl FnMut(RecordedTick) -> Result<()>) -> Result<()> {
    let mut clock = MonotonicClock;
    let start_ns = clock.now_ns();
    for (tick, turn) in (0..SECONDS * TURNS_HZ).zip(turns.iter().cycle()) {
        let time_ns = tick * (1_000_000_000 / TURNS_HZ);
        clock.sleep_until_ns(start_ns + time_ns);
        let mut turn = RecordedTick { tick, time_ns, ..turn.clone() };
        if let Some(scan) = &mut turn.scan {
            scan.time_ns = time_ns;
        }
        take(turn)?;
    }
    Ok(())
}

fn record(turns: &[RecordedTick], dir: &Path) -> Result<firmware_host::record::RecordingSummary> {
    let mut recorder =
        Recorder::start(RecorderOptions::robot(dir), RunHeader::new("bench", camera()))?;
    paced(turns, |turn| Ok(recorder.record(turn, Views::default())?))?;
    Ok(recorder.finish()?)
}

fn write_plainly(turns: &[RecordedTick], path: &Path) -> Result<()> {
    let mut writer = mcap::Writer::new(BufWriter::new(File::create(path)?))?;
    let channel =
        |writer: &mut mcap::Writer<_>, topic| writer.add_channel(0, topic, "raw", &BTreeMap::new());
    let images = channel(&mut writer, "/camera/image")?;
    let scans = channel(&mut writer, "/scan")?;
    paced(turns, |turn| {
        let header = |channel_id| mcap::records::MessageHeader {
            channel_id,
            sequence: turn.tick as u32,
            log_time: turn.time_ns,
            publish_time: turn.time_ns,
        };
        let ranges = turn.scan.iter().flat_map(|scan| &scan.ranges);
        let bytes: Vec<u8> =
            ranges.flat_map(|range| range.hit_m().unwrap_or(0.0).to_le_bytes()).collect();
        writer.write_to_known_channel(&header(scans), &bytes)?;
        if let Some(frame) = &turn.frame {
            writer.write_to_known_channel(&header(images), &Cow::Borrowed(&frame.rgb))?;
        }
        Ok(())
    })?;
    writer.finish()?;
    Ok(())
}
