//! Reading of recorded ticks and encoding of images, for all exports.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use runtime::recording::{RecordedTick, RecordingError, RecordingReader, SegmentHeader};

use crate::error::StoreError;

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
