//! The image front end as `firmware-host run` calls it: from a camera frame of 640x480 to an undistorted RGB8 image of
//! 640x192. The peer is OpenCV with the same result: conversion (or JPEG decoding) to RGB8, then `remap` with fixed-point
//! maps (CV_16SC2). OpenCV's conversion has no region of interest for these formats and converts all rows; ours converts only
//! the rows that the remapping reads.

use std::io::Cursor;
use std::time::Instant;

use anyhow::Result;
use hal::{CameraModel, Distortion, ImageView, PixelFormat};
use image::codecs::jpeg::JpegEncoder;
use runtime::imaging::{FrontEnd, YuvRange};

use crate::peers::PeerProcess;
use crate::report::{Row, Timing};

const AREA: &str = "perception";
const RUNS: usize = 200;
const SOURCE: CameraModel = CameraModel {
    width: 640,
    height: 480,
    fx: 420.0,
    fy: 420.0,
    cx: 321.0,
    cy: 238.0,
    distortion: Distortion::PlumbBob([-0.28, 0.07, 0.0004, -0.0003, 0.0]),
};

/// Measures all rows of this module.
///
/// # Errors
/// When a frame is refused, or the peer fails.
pub fn rows() -> Result<Vec<Row>> {
    let target = CameraModel {
        width: 640,
        height: 192,
        fx: 400.0,
        fy: 400.0,
        cx: 319.5,
        cy: 95.5,
        ..SOURCE
    };
    let target = CameraModel { distortion: Distortion::None, ..target };
    let plain = CameraModel { distortion: Distortion::None, ..SOURCE };
    let rgb = scene();
    let operations = [
        ("yuyv", PixelFormat::Yuyv, yuyv(&rgb), SOURCE, target),
        ("nv12", PixelFormat::Nv12, nv12(&rgb), SOURCE, target),
        ("rgb8", PixelFormat::Rgb8, rgb.clone(), SOURCE, target),
        ("mjpeg", PixelFormat::Mjpeg, jpeg(&rgb)?, SOURCE, target),
        ("crop", PixelFormat::Rgb8, rgb.clone(), plain, plain.cropped(0.0, 144.0, 640, 192)),
    ];
    let folder = std::env::temp_dir().join(format!("imaging-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    for (name, _, data, _, _) in &operations {
        std::fs::write(folder.join(name), data)?;
    }
    let threads = rayon::current_num_threads();
    let mut peer = PeerProcess::start(
        "opencv_imaging.py",
        &[&threads.to_string(), &folder.to_string_lossy()],
    )?;
    let mut rows = Vec::new();
    for (name, format, data, source, target) in &operations {
        let frame = ImageView::new(source.width, source.height, *format, data)?;
        let mut front = FrontEnd::new(*source, *target, *format, YuvRange::Limited)?;
        let (ours, theirs) = measure(name, &mut front, frame, peer.as_mut())?;
        let what = match *name {
            "crop" => "front end: RGB8 640x480, cropped to RGB8 640x192".to_owned(),
            _ => format!("front end: {} 640x480 to undistorted RGB8 640x192", name.to_uppercase()),
        };
        let row = Row::seconds(AREA, what, ours).note(format!("{threads} threads"));
        let row = if *format == PixelFormat::Mjpeg { row } else { row.goal(1.0e-3, 0.3e-3) };
        rows.push(match theirs {
            Some(theirs) => row.peer(peer_name(name), theirs.median),
            None => row,
        });
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(rows)
}

/// What the peer computes.
fn peer_name(operation: &str) -> &'static str {
    match operation {
        "mjpeg" => "OpenCV imdecode to RGB8, remap",
        "rgb8" => "OpenCV remap",
        "crop" => "NumPy copy",
        _ => "OpenCV cvtColor of all rows to RGB8, remap",
    }
}

fn measure(
    name: &str,
    front: &mut FrontEnd,
    frame: ImageView<'_>,
    mut peer: Option<&mut PeerProcess>,
) -> Result<(Timing, Option<Timing>)> {
    let mut rgb = vec![0; 3 * front.target().width * front.target().height];
    let mut ours = Vec::new();
    let mut theirs = Vec::new();
    for _ in 0..RUNS {
        let start = Instant::now();
        front.to_rgb(frame, &mut rgb)?;
        ours.push(start.elapsed().as_secs_f64());
        if let Some(peer) = &mut peer {
            theirs.push(peer.seconds(name)?);
        }
    }
    Ok((Timing::of(ours), peer.map(|_| Timing::of(theirs))))
}

/// An RGB image with colours, edges and texture.
fn scene() -> Vec<u8> {
    let pixels = (0..SOURCE.width * SOURCE.height).flat_map(|index| {
        let u = (index % SOURCE.width) as f64;
        let v = (index / SOURCE.width) as f64;
        let tile = index % SOURCE.width / 40 + index / SOURCE.width / 30;
        let edge = if tile.is_multiple_of(2) { 30.0 } else { -30.0 };
        [(0.05, 0.02), (-0.03, 0.07), (0.31, 0.23)]
            .map(|(fu, fv)| 128.0 + edge + 50.0 * (u * fu + v * fv).sin())
            .map(|value| value as u8)
    });
    pixels.collect()
}

/// The duration does not depend on the values, so the conversion is simplified: luma is green, chroma red and blue.
fn yuyv(rgb: &[u8]) -> Vec<u8> {
    rgb.chunks_exact(6).flat_map(|pair| [pair[1], pair[2], pair[4], pair[0]]).collect()
}

fn nv12(rgb: &[u8]) -> Vec<u8> {
    let luma = rgb.iter().skip(1).step_by(3).copied();
    let colour = rgb.chunks_exact(3 * SOURCE.width).step_by(2).flat_map(|row| row.chunks_exact(6));
    luma.chain(colour.flat_map(|pair| [pair[2], pair[0]])).collect()
}

fn jpeg(rgb: &[u8]) -> Result<Vec<u8>> {
    let mut file = Cursor::new(Vec::new());
    let width = SOURCE.width as u32;
    let height = SOURCE.height as u32;
    JpegEncoder::new_with_quality(&mut file, 85).encode(
        rgb,
        width,
        height,
        image::ExtendedColorType::Rgb8,
    )?;
    Ok(file.into_inner())
}
