use super::*;
use crate::perception::test_scene::{depth_m, pose, render};
use hal::PixelFormat;

fn small_camera() -> CameraModel {
    CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
}

fn engine() -> CoarseDepth {
    CoarseDepth::new(CoarseConfig::default(), small_camera()).unwrap()
}

fn estimate<'a>(
    engine: &'a mut CoarseDepth,
    at: &Pose3,
    gain: f64,
    offset: f64,
) -> Result<&'a DepthEstimate, NoDepth> {
    let camera = engine.camera;
    let image = render(&camera, at, gain, offset);
    engine.estimate(
        ImageView::new(camera.width, camera.height, PixelFormat::Gray8, &image).unwrap(),
        at,
    )
}

fn sideways(i: u32) -> Pose3 {
    pose([0.03 * f64::from(i), 0.0, 0.0], 0.0)
}

/// Forward on an arc.
fn arc(i: u32) -> Pose3 {
    let i = f64::from(i);
    pose([0.01 * i, 0.0, 0.03 * i], 0.01 * i)
}

/// Median relative error, and share of pixels with depth.
fn errors(camera: &CameraModel, estimate: &DepthEstimate, at: &Pose3) -> (f64, f64) {
    let mut errors: Vec<f64> = estimate
        .depth
        .values()
        .iter()
        .enumerate()
        .filter(|(_, depth)| **depth > 0.0)
        .map(|(i, depth)| {
            let u = (i % camera.width) as f64;
            let v = (i / camera.width) as f64;
            (f64::from(*depth) / depth_m(camera, at, u, v) - 1.0).abs()
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors.len() as f64 / (camera.width * camera.height) as f64)
}

fn travel(
    camera: CameraModel,
    path: impl Fn(u32) -> Pose3,
    steps: u32,
    gain: impl Fn(u32) -> f64,
) -> (f64, f64) {
    let mut engine = CoarseDepth::new(CoarseConfig::default(), camera).unwrap();
    for i in 0..steps {
        let _ = estimate(&mut engine, &path(i), gain(i), 0.0);
    }
    errors(&camera, estimate(&mut engine, &path(steps), gain(steps), 0.0).unwrap(), &path(steps))
}

#[test]
fn a_slanted_plane_seen_sideways_is_found_within_half_a_percent() {
    let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
    let (error, share) = travel(camera, sideways, 12, |_| 1.0);
    assert!(error < 0.005 && share > 0.8, "{error} {share}");
}

#[test]
fn a_plane_seen_on_an_arc_forward_is_found() {
    let (error, share) = travel(small_camera(), arc, 16, |_| 1.0);
    assert!(error < 0.02 && share > 0.6, "{error} {share}");
}

#[test]
fn a_change_of_exposure_changes_little() {
    let (error, share) =
        travel(small_camera(), sideways, 12, |i| if i % 2 == 0 { 1.0 } else { 1.3 });
    assert!(error < 0.01 && share > 0.7, "{error} {share}");
}

#[test]
fn the_first_frame_has_no_depth() {
    assert_eq!(estimate(&mut engine(), &sideways(0), 1.0, 0.0).unwrap_err(), NoDepth::FirstFrame);
}

#[test]
fn rotating_in_place_and_standing_still_give_no_depth() {
    let mut engine = engine();
    let _ = estimate(&mut engine, &sideways(0), 1.0, 0.0);
    for i in 0..12 {
        let turned = pose([0.0; 3], 0.035 * f64::from(i / 2));
        assert_eq!(
            estimate(&mut engine, &turned, 1.0, 0.0).unwrap_err(),
            NoDepth::TooLittleParallax
        );
    }
}

#[test]
fn beliefs_last_for_part_of_a_rotation_and_stay_accurate() {
    let mut engine = engine();
    for i in 0..10 {
        let _ = estimate(&mut engine, &sideways(i), 1.0, 0.0);
    }
    // Without a usable keyframe, depth comes from beliefs only.
    engine.keyframes.forget();
    engine.keyframes.offer(&sideways(9), &mut engine.image, &engine.config);
    let before = estimate(&mut engine, &sideways(9), 1.0, 0.0).unwrap().clone();
    let turned = pose([0.27, 0.0, 0.0], 0.1);
    let after = estimate(&mut engine, &turned, 1.0, 0.0).unwrap();
    let (error, share) = errors(&small_camera(), after, &turned);
    assert!(error < 0.02 && share > 0.5 && share < 0.95, "{error} {share}");
    let [before, after] =
        [&before, after].map(|estimate| estimate.confidence.iter().copied().fold(0.0, f32::max));
    assert!(after < before);
    let mut last = Ok(());
    for _ in 0..60 {
        last = estimate(&mut engine, &turned, 1.0, 0.0).map(|_| ());
    }
    assert_eq!(last, Err(NoDepth::TooLittleParallax));
}

#[test]
fn a_jump_of_the_pose_discards_everything() {
    let mut engine = engine();
    for i in 0..10 {
        let _ = estimate(&mut engine, &sideways(i), 1.0, 0.0);
    }
    let far = pose([2.0, 0.0, 0.0], 0.0);
    assert_eq!(estimate(&mut engine, &far, 1.0, 0.0).unwrap_err(), NoDepth::PoseJump);
    assert_eq!(estimate(&mut engine, &far, 1.0, 0.0).unwrap_err(), NoDepth::TooLittleParallax);
}

#[test]
fn a_refused_frame_does_not_change_later_depth() {
    let mut one = engine();
    let mut two = engine();
    for i in 0..8 {
        let _ = estimate(&mut one, &sideways(i), 1.0, 0.0);
        let _ = estimate(&mut two, &sideways(i), 1.0, 0.0);
        let mut nan = sideways(i);
        nan.translation.x = f64::NAN;
        assert_eq!(estimate(&mut two, &nan, 1.0, 0.0).unwrap_err(), NoDepth::PoseNotFinite);
        let black = vec![3; 320 * 96];
        let black = ImageView::new(320, 96, PixelFormat::Gray8, &black).unwrap();
        assert_eq!(two.estimate(black, &sideways(i)).unwrap_err(), NoDepth::NoTexture);
        let small = ImageView::new(32, 32, PixelFormat::Gray8, &[0; 1024]).unwrap();
        assert_eq!(two.estimate(small, &sideways(i)).unwrap_err(), NoDepth::FrameSize);
    }
    assert_eq!(
        estimate(&mut one, &sideways(8), 1.0, 0.0).unwrap(),
        estimate(&mut two, &sideways(8), 1.0, 0.0).unwrap()
    );
}

#[test]
fn a_frozen_camera_gives_no_depth_until_it_delivers_new_frames() {
    let mut engine = engine();
    for i in 0..8 {
        let _ = estimate(&mut engine, &sideways(i), 1.0, 0.0);
    }
    let frozen = render(&engine.camera, &sideways(7), 1.0, 0.0);
    for i in 8..12 {
        let image = ImageView::new(320, 96, PixelFormat::Gray8, &frozen).unwrap();
        assert_eq!(engine.estimate(image, &sideways(i)).unwrap_err(), NoDepth::SameImage);
    }
    assert!(estimate(&mut engine, &sideways(12), 1.0, 0.0).is_ok());
}

#[test]
fn a_saturated_frame_has_no_texture() {
    let white = vec![255; 320 * 96];
    let white = ImageView::new(320, 96, PixelFormat::Gray8, &white).unwrap();
    assert_eq!(engine().estimate(white, &sideways(0)).unwrap_err(), NoDepth::NoTexture);
}

#[test]
fn one_thread_and_four_give_the_same_bits() {
    let [one, four] = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut engine = engine();
            for i in 0..8 {
                let _ = estimate(&mut engine, &arc(i), 1.0, 0.0);
            }
            estimate(&mut engine, &arc(8), 1.0, 0.0).unwrap().clone()
        })
    });
    assert_eq!(one, four);
}

#[test]
fn a_camera_that_cannot_be_used_is_refused() {
    let good = small_camera();
    let distorted = CameraModel { distortion: Distortion::PlumbBob([0.1; 5]), ..good };
    for bad in [CameraModel { fx: f64::NAN, ..good }, CameraModel { width: 8, ..good }, distorted] {
        assert!(matches!(
            CoarseDepth::new(CoarseConfig::default(), bad),
            Err(PerceptionError::Camera { .. })
        ));
    }
}

#[test]
fn odd_sizes_work() {
    let camera = CameraModel::pinhole(101, 53, 1.2);
    let mut engine = CoarseDepth::new(CoarseConfig::default(), camera).unwrap();
    for i in 0..12 {
        let image = render(&camera, &sideways(i), 1.0, 0.0);
        let _ = engine
            .estimate(ImageView::new(101, 53, PixelFormat::Gray8, &image).unwrap(), &sideways(i));
    }
    assert!(engine.last().depth.values().iter().any(|depth| *depth > 0.0));
}
