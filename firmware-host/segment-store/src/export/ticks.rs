//! Reading of recorded ticks and encoding of images, for all exports.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use runtime::recording::{RecordedTick, RecordingError, RecordingReader, SegmentHeader};

use crate::error::StoreError;

/// The header of a segment; `None` when the segment is cut before it or is no recording, which the export reports.
pub(super) fn header(path: &Path) -> Result<Option<SegmentHeader>, StoreError> {
    let file = File::open(path).map_err(StoreError::read(path))?;
    Ok(RecordingReader::open(BufReader::new(file)).ok().map(|reader| reader.header().clone()))
}

/// Refuses segments that do not have the order of their ticks, because an export would then run backwards.
pub(super) fn check_order(segments: &[PathBuf]) -> Result<(), StoreError> {
    let mut before: Option<(&PathBuf, u64)> = None;
    for path in segments {
        let Some(SegmentHeader { first_tick, .. }) = header(path)? else { continue };
        if let Some((other, other_tick)) = before.filter(|(_, tick)| *tick >= first_tick) {
            let detail = format!(
                "begins at tick {first_tick}, but {} before it at tick {other_tick}; name the segments of a run in the order of \
                 their ticks, and put each run into a directory of its own",
                other.display()
            );
            return Err(StoreError::Segment { path: path.clone(), detail });
        }
        before = Some((path, first_tick));
    }
    Ok(())
}

/// What an error about all of `segments` calls them: the one segment, or the directory of the run.
pub(super) fn shown(segments: &[PathBuf]) -> PathBuf {
    match segments {
        [one] => one.clone(),
        [first, ..] => first.parent().unwrap_or(first).to_owned(),
        [] => PathBuf::new(),
    }
}

/// The error for a run without a tick that can be read.
pub(super) fn no_tick(segments: &[PathBuf]) -> StoreError {
    let detail =
        "no tick can be read, so there is nothing to export; `firmware-host buffer verify` says what is wrong".to_owned();
    StoreError::Segment { path: shown(segments), detail }
}

/// Calls `each` for every tick of `segments` in the given order. Returns the number of segments that end early.
pub(super) fn each_tick(
    segments: &[PathBuf],
    mut each: impl FnMut(&SegmentHeader, &RecordedTick) -> Result<(), StoreError>,
) -> Result<u64, StoreError> {
    let mut cut = 0;
    for path in segments {
        let file = File::open(path).map_err(StoreError::read(path))?;
        let reader = match RecordingReader::open(BufReader::with_capacity(1 << 20, file)) {
            Ok(reader) => reader,
            // Cut before its first tick.
            Err(error) if error.is_truncation() => {
                cut += 1;
                continue;
            }
            Err(error) => return Err(unreadable(path, &error)),
        };
        let header = reader.header().clone();
        for tick in reader {
            match tick {
                Ok(tick) => each(&header, &tick)?,
                Err(error) if error.is_truncation() => {
                    cut += 1;
                    break;
                }
                Err(error) => return Err(unreadable(path, &error)),
            }
        }
    }
    Ok(cut)
}

fn unreadable(path: &Path, error: &RecordingError) -> StoreError {
    StoreError::Segment { path: path.to_owned(), detail: error.to_string() }
}

/// Encodes an image as PNG.
pub(super) fn png(
    bytes: &[u8],
    width: usize,
    height: usize,
    color: image::ExtendedColorType,
) -> std::io::Result<Vec<u8>> {
    use image::ImageEncoder;
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    encoder
        .write_image(bytes, width as u32, height as u32, color)
        .map_err(std::io::Error::other)?;
    Ok(png)
}

/// The frame rate, from the median time between two images; 10 when there are fewer than two.
pub(super) fn frames_per_second(times_ns: &[u64]) -> f64 {
    let mut steps: Vec<u64> = times_ns
        .windows(2)
        .filter_map(|pair| Some(pair.get(1)?.saturating_sub(*pair.first()?)))
        .collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).filter(|step| **step > 0).map_or(10.0, |step| 1e9 / *step as f64)
}
