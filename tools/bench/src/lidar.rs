//! Decoding of a LiDAR's bytes to a scan. The peer decodes as the specification describes it and as known libraries do: one
//! character after the other, then one number after the other.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use drivers::scip::{self, Framer, Model, RangeCodes, Reply};
use hal::{LaserScan, Range, Twist2, WheelFeedback};
use runtime::safety::{Plan, Request, SafetyConfig, SafetyInput, SafetyPlane};

use crate::report::{Row, Timing, Unit, time_against};

const AREA: &str = "drivers";
const RUNS: usize = 200;
/// Scans decoded in one timed run, so that the clock's resolution does not matter.
const SCANS: usize = 200;
/// Number of single scans for the percentiles.
const SINGLES: usize = 20_000;
/// Bytes of one read: a high-speed USB packet.
const PIECE: usize = 512;

/// Measures all rows of this module.
///
/// # Errors
/// When a scan is refused.
pub fn rows() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (what, without_return) in [("all distances", 0), ("2 % without return", 2)] {
        let (request, message) =
            scan(
                |beam| {
                    if beam * 7919 % 100 < without_return { 1 } else { 500 + beam * 37 % 20_000 }
                },
            );
        rows.push(decode(what, &request, &message)?);
    }
    rows.extend(latency()?);
    Ok(rows)
}

fn decode(what: &str, request: &scip::Request, message: &[u8]) -> Result<Row> {
    let codes = Model::Utm30lx.spec().codes;
    let mut ranges = vec![Range::Error; request.beams()];
    Reply::read(message, request, &codes, &mut ranges)?;
    ensure!(textbook(message, &codes).as_deref() == Some(&ranges[..]), "the two decoders differ");
    let (ours, theirs) = time_against(
        RUNS,
        || {
            for _ in 0..SCANS {
                _ = black_box(Reply::read(black_box(message), request, &codes, &mut ranges));
            }
        },
        || {
            (0..SCANS)
                .map(|_| textbook(black_box(message), &codes))
                .fold(0, |sum, scan| sum + scan.map_or(0, |scan| scan.len()))
        },
    );
    let bytes = message.len() * SCANS;
    Ok(Row::new(
        AREA,
        format!("SCIP decode, MD, 1081 beams, {what}"),
        Unit::MegabytesPerSecond,
        rate(bytes, ours),
    )
    .peer("textbook", rate(bytes, theirs).median)
    .goal(500.0, 2000.0)
    .note(format!("{} bytes per scan, all checksums verified", message.len())))
}

/// Latency from the bytes, in pieces as they are read, to the decision of the safety plane. The robot drives through a narrow
/// passage, so that every beam is within the zones that the safety plane checks.
fn latency() -> Result<Vec<Row>> {
    let (request, message) = scan(|beam| 600 + 600 * beam.abs_diff(540) / 540);
    let mut plane = SafetyPlane::new(SafetyConfig { period_s: 0.025, ..SafetyConfig::default() });
    let codes = Model::Utm30lx.spec().codes;
    let mut framer = Box::new(Framer::<16_384>::default());
    let geometry = Model::Utm30lx.geometry(false);
    let mut scan = LaserScan { time_ns: 0, geometry, ranges: vec![Range::Error; geometry.beams] };
    let mut times = Vec::with_capacity(SINGLES);
    for tick in 1..=SINGLES as u64 {
        let start = Instant::now();
        for piece in message.chunks(PIECE) {
            framer
                .free_space()
                .get_mut(..piece.len())
                .context("the buffer is too small")?
                .copy_from_slice(piece);
            framer.received(piece.len());
        }
        let whole = framer.message().context("no message")?;
        Reply::read(whole, &request, &codes, &mut scan.ranges)?;
        scan.time_ns = tick * 25_000_000;
        let output = black_box(plane.step(&driving(&scan)));
        times.push(start.elapsed().as_secs_f64());
        ensure!(
            output.twist().linear_mps > 0.0,
            "the path is free, but the robot does not drive: {output:?}"
        );
    }
    let name = "scan bytes to motion decision, 1081 beams";
    let median = Timing::of(times.clone());
    times.sort_by(f64::total_cmp);
    let p99 = Timing { median: times[(SINGLES * 99).div_ceil(100) - 1], ..median };
    let note = "decode, checksums, zones, state machine";
    Ok(vec![
        Row::seconds(AREA, format!("{name}, median"), median).note(note),
        Row::seconds(AREA, format!("{name}, 99th percentile"), p99).goal(100e-6, 20e-6).note(note),
    ])
}

/// The rate of decoding this number of bytes, from its duration.
fn rate(bytes: usize, timing: Timing) -> Timing {
    let megabytes = bytes as f64 * 1e-6;
    Timing {
        min: megabytes / timing.max,
        median: megabytes / timing.median,
        max: megabytes / timing.min,
    }
}

fn driving(scan: &LaserScan) -> SafetyInput<'_> {
    let time_ns = scan.time_ns;
    SafetyInput {
        time_ns,
        scan: Some(scan),
        wheel: Some(WheelFeedback { time_ns, ..WheelFeedback::default() }),
        base_error: None,
        emergency_stop: false,
        suspended: false,
        plan: Some(Plan { twist: Twist2 { linear_mps: 0.3, angular_radps: 0.0 }, time_ns }),
        request: Some(Request::Arm),
    }
}

/// The request and the reply of a scan whose beams measure `value`, millimetres.
fn scan(value: impl Fn(u32) -> u32) -> (scip::Request, Vec<u8>) {
    let request = Model::Utm30lx.request(0);
    let (echo, length) = request.encode();
    let mut message = echo[..length].to_vec();
    for content in [&b"99"[..], b"0000"] {
        push_line(&mut message, content);
    }
    let data: Vec<u8> = (0..request.beams() as u32)
        .flat_map(|beam| [12, 6, 0].map(|shift| (value(beam) >> shift & 63) as u8 + 0x30))
        .collect();
    data.chunks(64).for_each(|line| push_line(&mut message, line));
    message.push(b'\n');
    (request, message)
}

fn push_line(message: &mut Vec<u8>, content: &[u8]) {
    message.extend_from_slice(content);
    message.push((content.iter().map(|byte| u32::from(*byte)).sum::<u32>() % 64) as u8 + 0x30);
    message.push(b'\n');
}

/// A straightforward decoder: checks the sum of each line, joins the characters of all lines, and decodes three of them at a
/// time.
fn textbook(message: &[u8], codes: &RangeCodes) -> Option<Vec<Range>> {
    let mut data = Vec::with_capacity(message.len());
    for (number, line) in
        message.strip_suffix(b"\n\n")?.split(|byte| *byte == b'\n').enumerate().skip(1)
    {
        let (sum, content) = line.split_last()?;
        let mut total = 0_u32;
        for byte in content {
            total += u32::from(*byte);
        }
        if u32::from(*sum) != total % 64 + 0x30 {
            return None;
        }
        if number > 2 {
            data.extend_from_slice(content);
        }
    }
    let numbers = data.chunks_exact(3).map(|characters| {
        characters.iter().fold(0, |number, byte| number << 6 | u32::from(byte.wrapping_sub(0x30)))
    });
    Some(numbers.map(|number| codes.range(number)).collect())
}
