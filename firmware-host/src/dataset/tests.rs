use std::fs;

use image::{GrayImage, ImageBuffer, Luma, RgbImage};
use tempfile::TempDir;

use super::*;

/// A dataset of three frames of 64x48. Depth is 1 m plus 1 mm per column; the left-most column has
/// none.
fn sequence() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    let manifest = "name = \"tiny\"\nnominal_fps = 10\ndepth_scale = 1000\n[camera]\nwidth = 64\nheight = 48\n\
                    fx = 50.0\nfy = 50.0\ncx = 31.5\ncy = 23.5\n";
    fs::write(root.join("dataset.toml"), manifest).unwrap();
    let mut rgb_list = String::new();
    let mut depth_list = String::new();
    let mut poses = String::new();
    for i in 0..3_u8 {
        RgbImage::from_pixel(64, 48, image::Rgb([i * 10, 20, 30]))
            .save(root.join(format!("{i}.png")))
            .unwrap();
        ImageBuffer::from_fn(64, 48, |x, _| Luma([if x == 0 { 0_u16 } else { 1000 + x as u16 }]))
            .save(root.join(format!("d{i}.png")))
            .unwrap();
        rgb_list += &format!("0.{i} {i}.png\n");
        depth_list += &format!("0.{i}1 d{i}.png\n");
        poses += &format!("0.{i} {i} 0 0 0 0 0 1\n");
    }
    fs::write(root.join("rgb.txt"), rgb_list).unwrap();
    fs::write(root.join("depth.txt"), depth_list).unwrap();
    fs::write(root.join("groundtruth.txt"), poses).unwrap();
    dir
}

fn open(dir: &TempDir) -> Result<Dataset, DatasetError> {
    Dataset::open(dir.path(), 64, 32)
}

fn first_error(dir: &TempDir) -> String {
    match open(dir) {
        Err(error) => error.to_string(),
        Ok(dataset) => dataset.samples().find_map(Result::err).unwrap().to_string(),
    }
}

#[test]
fn samples_come_in_order_with_pose_image_and_truth() {
    let dir = sequence();
    let dataset = open(&dir).unwrap();
    assert_eq!((dataset.len(), dataset.without_pose(), dataset.camera().cy), (3, 0, 15.5));
    let samples: Vec<Sample> = dataset.samples().map(Result::unwrap).collect();
    assert_eq!(samples[2].time_ns, 200_000_000);
    assert_eq!(samples[2].rgb[..3], [20, 20, 30]);
    assert!((samples[2].t_world_camera.translation.x - 2.0).abs() < 1e-12);
    let truth = samples[1].truth.as_ref().unwrap();
    assert_eq!((truth.get(0, 5), truth.get(7, 5)), (None, Some(1.007)));
}

#[test]
fn images_without_a_pose_are_left_out_and_counted() {
    let dir = sequence();
    fs::write(dir.path().join("groundtruth.txt"), "0.0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n")
        .unwrap();
    let dataset = open(&dir).unwrap();
    assert_eq!((dataset.len(), dataset.without_pose()), (2, 1));
    fs::write(dir.path().join("groundtruth.txt"), "77.0 0 0 0 0 0 0 1\n").unwrap();
    assert!(first_error(&dir).contains("none of the 3 images"));
}

#[test]
fn without_depth_images_there_is_no_truth() {
    let dir = sequence();
    fs::remove_file(dir.path().join("depth.txt")).unwrap();
    assert!(open(&dir).unwrap().samples().all(|sample| sample.unwrap().truth.is_none()));
}

#[test]
fn an_image_of_another_size_is_refused_with_both_sizes() {
    let dir = sequence();
    ImageBuffer::from_pixel(32, 24, Luma([5_u16])).save(dir.path().join("d1.png")).unwrap();
    let error = first_error(&dir);
    assert!(
        error.contains("d1.png") && error.contains("32x24") && error.contains("64x48"),
        "{error}"
    );
}

#[test]
fn a_truncated_png_is_named() {
    let dir = sequence();
    let path = dir.path().join("1.png");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(first_error(&dir).contains("1.png"));
}

#[test]
fn eight_bit_depth_is_refused() {
    let dir = sequence();
    GrayImage::new(64, 48).save(dir.path().join("d0.png")).unwrap();
    assert!(first_error(&dir).contains("16 bits"));
}

#[test]
fn a_missing_manifest_list_or_image_is_named() {
    for (name, named) in [
        ("dataset.toml", "dataset.toml"),
        ("rgb.txt", "rgb.txt"),
        ("groundtruth.txt", "groundtruth.txt"),
        ("2.png", "rgb.txt:3"),
    ] {
        let dir = sequence();
        fs::remove_file(dir.path().join(name)).unwrap();
        assert!(first_error(&dir).contains(named));
    }
}
