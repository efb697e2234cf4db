use super::*;
use crate::perception::test_scene::{depth_m, pose, render};
use hal::PixelFormat;

fn small_camera() -> CameraModel {
    CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
}

fn engine() -> CoarseDepth {
    CoarseDepth::new(CoarseConfig::default(), small_camera()).unwrap()
}

fn look<'a>(
    engine: &'a mut CoarseDepth,
    at: &Pose3,
    gain: f64,
    offset: f64,
) -> Result<&'a DepthEstimate, NoDepth> {
    let camera = engine.camera;
    let picture = render(&camera, at, gain, offset);
    engine.estimate(
        ImageView::new(camera.width, camera.height, PixelFormat::Gray8, &picture).unwrap(),
        at,
    )
}

/// Sideways, and on an arc forward.
fn sideways(i: u32) -> Pose3 {
    pose([0.03 * f64::from(i), 0.0, 0.0], 0.0)
}

fn arc(i: u32) -> Pose3 {
    let i = f64::from(i);
    pose([0.01 * i, 0.0, 0.03 * i], 0.01 * i)
}

/// Median relative error, and share of pixels with depth.
fn errors(camera: &CameraModel, estimate: &DepthEstimate, at: &Pose3) -> (f64, f64) {
    let pixel = |i: usize| ((i % camera.width) as f64, (i / camera.width) as f64);
    let mut errors: Vec<f64> = estimate
        .depth
        .values()
        .iter()
        .enumerate()
        .filter(|(_, depth)| **depth > 0.0)
        .map(|(i, depth)| {
            (f64::from(*depth) / depth_m(camera, at, pixel(i).0, pixel(i).1) - 1.0).abs()
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
        let _ = look(&mut engine, &path(i), gain(i), 0.0);
    }
    errors(&camera, look(&mut engine, &path(steps), gain(steps), 0.0).unwrap(), &path(steps))
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
fn the_first_picture_has_no_depth() {
    assert_eq!(look(&mut engine(), &sideways(0), 1.0, 0.0).unwrap_err(), NoDepth::FirstFrame);
}

#[test]
fn turning_on_the_spot_and_standing_still_give_no_depth() {
    let mut engine = engine();
    let _ = look(&mut engine, &sideways(0), 1.0, 0.0);
    for i in 0..12 {
        let turned = pose([0.0; 3], 0.035 * f64::from(i / 2));
        assert_eq!(look(&mut engine, &turned, 1.0, 0.0).unwrap_err(), NoDepth::TooLittleParallax);
    }
}

#[test]
fn depth_is_remembered_for_some_of_a_turn_and_stays_true() {
    let mut engine = engine();
    for i in 0..10 {
        let _ = look(&mut engine, &sideways(i), 1.0, 0.0);
    }
    // Nothing to compare with any more, only what is believed.
    engine.keyframes.forget();
    engine.keyframes.offer(&sideways(9), &mut engine.picture, &engine.config);
    let before = look(&mut engine, &sideways(9), 1.0, 0.0).unwrap().clone();
    let turned = pose([0.27, 0.0, 0.0], 0.1);
    let after = look(&mut engine, &turned, 1.0, 0.0).unwrap();
    let (error, share) = errors(&small_camera(), after, &turned);
    assert!(error < 0.02 && share > 0.5 && share < 0.95, "{error} {share}");
    let most = |estimate: &DepthEstimate| estimate.confidence.iter().copied().fold(0.0, f32::max);
    assert!(most(after) < most(&before));
    let mut last = Ok(());
    for _ in 0..60 {
        last = look(&mut engine, &turned, 1.0, 0.0).map(|_| ());
    }
    assert_eq!(last, Err(NoDepth::TooLittleParallax));
}

#[test]
fn a_jump_of_the_pose_forgets_everything() {
    let mut engine = engine();
    for i in 0..10 {
        let _ = look(&mut engine, &sideways(i), 1.0, 0.0);
    }
    let far = pose([2.0, 0.0, 0.0], 0.0);
    assert_eq!(look(&mut engine, &far, 1.0, 0.0).unwrap_err(), NoDepth::PoseJump);
    assert_eq!(look(&mut engine, &far, 1.0, 0.0).unwrap_err(), NoDepth::TooLittleParallax);
}

#[test]
fn a_refused_picture_leaves_no_trace() {
    let (mut one, mut two) = (engine(), engine());
    for i in 0..8 {
        let _ = look(&mut one, &sideways(i), 1.0, 0.0);
        let _ = look(&mut two, &sideways(i), 1.0, 0.0);
        let mut nan = sideways(i);
        nan.translation.x = f64::NAN;
        assert_eq!(look(&mut two, &nan, 1.0, 0.0).unwrap_err(), NoDepth::PoseNotFinite);
        let black = vec![3; 320 * 96];
        let black = ImageView::new(320, 96, PixelFormat::Gray8, &black).unwrap();
        assert_eq!(two.estimate(black, &sideways(i)).unwrap_err(), NoDepth::NoTexture);
        let small = ImageView::new(32, 32, PixelFormat::Gray8, &[0; 1024]).unwrap();
        assert_eq!(two.estimate(small, &sideways(i)).unwrap_err(), NoDepth::FrameSize);
    }
    assert_eq!(
        look(&mut one, &sideways(8), 1.0, 0.0).unwrap(),
        look(&mut two, &sideways(8), 1.0, 0.0).unwrap()
    );
}

#[test]
fn a_frozen_camera_gives_no_depth_and_is_looked_through_when_it_thaws() {
    let mut engine = engine();
    for i in 0..8 {
        let _ = look(&mut engine, &sideways(i), 1.0, 0.0);
    }
    let frozen = render(&engine.camera, &sideways(7), 1.0, 0.0);
    for i in 8..12 {
        let picture = ImageView::new(320, 96, PixelFormat::Gray8, &frozen).unwrap();
        assert_eq!(engine.estimate(picture, &sideways(i)).unwrap_err(), NoDepth::SamePicture);
    }
    assert!(look(&mut engine, &sideways(12), 1.0, 0.0).is_ok());
}

#[test]
fn a_saturated_picture_has_no_texture() {
    let white = vec![255; 320 * 96];
    let white = ImageView::new(320, 96, PixelFormat::Gray8, &white).unwrap();
    assert_eq!(engine().estimate(white, &sideways(0)).unwrap_err(), NoDepth::NoTexture);
}

#[test]
fn one_thread_and_four_give_the_same_bits() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut engine = engine();
            for i in 0..8 {
                let _ = look(&mut engine, &arc(i), 1.0, 0.0);
            }
            look(&mut engine, &arc(8), 1.0, 0.0).unwrap().clone()
        })
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn a_camera_that_cannot_work_is_refused() {
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
        let picture = render(&camera, &sideways(i), 1.0, 0.0);
        let _ = engine
            .estimate(ImageView::new(101, 53, PixelFormat::Gray8, &picture).unwrap(), &sideways(i));
    }
    assert!(engine.last().depth.values().iter().any(|depth| *depth > 0.0));
}
