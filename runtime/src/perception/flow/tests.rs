//! What the engine promises, on pictures whose flow is known.

use hal::{CameraModel, DepthMap, ImageView, PixelFormat, Pose3};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::*;
use crate::perception::test_scene;

const WIDTH: usize = 200;
const HEIGHT: usize = 120;
const PRESETS: [FlowPreset; 3] = [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium];

/// A place's motion from the first picture to the second: `place -> matrix * (place - middle) + middle + shift`.
#[derive(Clone, Copy)]
struct Motion {
    matrix: [[f32; 2]; 2],
    shift: [f32; 2],
}

impl Motion {
    fn shift(x: f32, y: f32) -> Self {
        Self { matrix: [[1.0, 0.0], [0.0, 1.0]], shift: [x, y] }
    }

    fn apply(&self, x: f32, y: f32) -> [f32; 2] {
        let (mx, my) = (WIDTH as f32 / 2.0, HEIGHT as f32 / 2.0);
        let (x, y) = (x - mx, y - my);
        let [[a, b], [c, d]] = self.matrix;
        [a * x + b * y + mx + self.shift[0], c * x + d * y + my + self.shift[1]]
    }

    fn inverse(&self, x: f32, y: f32) -> [f32; 2] {
        let (mx, my) = (WIDTH as f32 / 2.0, HEIGHT as f32 / 2.0);
        let (x, y) = (x - mx - self.shift[0], y - my - self.shift[1]);
        let [[a, b], [c, d]] = self.matrix;
        let determinant = a * d - b * c;
        [(d * x - b * y) / determinant + mx, (a * y - c * x) / determinant + my]
    }
}

/// Waves of many directions and lengths (5 to 60 pixels): a texture without cells or edges.
fn texture(x: f32, y: f32) -> f32 {
    (0..24).fold(128.0, |sum, wave| {
        let wave = wave as f32;
        let (angle, length) = (wave * 2.4, 5.0 * 1.115_f32.powf(wave));
        let along = x * angle.cos() + y * angle.sin();
        sum + 3.5
            * (length / 12.0).sqrt()
            * (along * std::f32::consts::TAU / length + wave * wave).sin()
    })
}

fn picture(grey: impl Fn(f32, f32) -> f32) -> Vec<u8> {
    (0..WIDTH * HEIGHT)
        .map(|i| grey((i % WIDTH) as f32, (i / WIDTH) as f32).round().clamp(0.0, 255.0) as u8)
        .collect()
}

fn moved(motion: Motion, gain: f32, offset: f32) -> Vec<u8> {
    picture(|x, y| {
        let [x, y] = motion.inverse(x, y);
        gain * texture(x, y) + offset
    })
}

fn view(data: &[u8]) -> ImageView<'_> {
    ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, data).unwrap()
}

/// Mean end-point error of pixels that stay in the picture, pixels.
fn error_px(flow: &FlowField, motion: Motion) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (index, [dx, dy]) in flow.values().iter().enumerate() {
        let (x, y) = ((index % WIDTH) as f32, (index / WIDTH) as f32);
        let [tx, ty] = motion.apply(x, y);
        if tx >= 0.0 && ty >= 0.0 && tx < WIDTH as f32 && ty < HEIGHT as f32 {
            sum += (x + dx - tx).hypot(y + dy - ty);
            count += 1.0;
        }
    }
    sum / count
}

fn flow(preset: FlowPreset, second: &[u8], initial: Option<&FlowField>) -> FlowField {
    let first = picture(texture);
    let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
    engine.flow(view(&first), view(second), initial).unwrap().clone()
}

#[test]
fn a_shifted_picture_gives_its_shift() {
    for (preset, bound_px) in PRESETS.into_iter().zip([0.2, 0.1, 0.08]) {
        for motion in
            [Motion::shift(0.5, 0.25), Motion::shift(3.3, -1.7), Motion::shift(-11.0, 4.6)]
        {
            let error = error_px(&flow(preset, &moved(motion, 1.0, 0.0), None), motion);
            assert!(error < bound_px, "{preset:?} {:?}: {error}", motion.shift);
        }
    }
}

#[test]
fn a_turned_and_grown_picture_gives_its_affine_flow() {
    let motion = Motion { matrix: [[1.03, -0.02], [0.02, 1.03]], shift: [2.0, 1.0] };
    for (preset, bound_px) in PRESETS.into_iter().zip([0.35, 0.25, 0.1]) {
        let error = error_px(&flow(preset, &moved(motion, 1.0, 0.0), None), motion);
        assert!(error < bound_px, "{preset:?}: {error}");
    }
}

#[test]
fn another_exposure_changes_little() {
    let motion = Motion::shift(3.3, -1.7);
    for (preset, bound_px) in PRESETS.into_iter().zip([0.25, 0.25, 0.15]) {
        let error = error_px(&flow(preset, &moved(motion, 1.15, 4.0), None), motion);
        assert!(error < bound_px, "{preset:?}: {error}");
    }
}

#[test]
fn a_good_initial_flow_makes_large_motion_possible() {
    let motion = Motion::shift(83.0, -31.0);
    let second = moved(motion, 1.0, 0.0);
    let initial = FlowField::from_vec(WIDTH, HEIGHT, vec![[80.0, -29.0]; WIDTH * HEIGHT]).unwrap();
    for (preset, bound_px) in PRESETS.into_iter().zip([0.5, 0.3, 0.1]) {
        let error = error_px(&flow(preset, &second, Some(&initial)), motion);
        assert!(error < bound_px, "{preset:?}: {error}");
    }
}

#[test]
fn an_initial_flow_of_nan_or_absurd_numbers_does_no_harm() {
    let second = moved(Motion::shift(3.3, -1.7), 1.0, 0.0);
    for bad in [f32::NAN, f32::INFINITY, -1e30] {
        let initial = FlowField::from_vec(WIDTH, HEIGHT, vec![[0.0, bad]; WIDTH * HEIGHT]).unwrap();
        assert_eq!(
            flow(FlowPreset::Fast, &second, Some(&initial)),
            flow(FlowPreset::Fast, &second, None)
        );
    }
}

#[test]
fn a_wrong_initial_flow_is_overruled_by_the_pictures() {
    let motion = Motion::shift(3.3, -1.7);
    let initial = FlowField::from_vec(WIDTH, HEIGHT, vec![[-25.0, 14.0]; WIDTH * HEIGHT]).unwrap();
    let error =
        error_px(&flow(FlowPreset::Medium, &moved(motion, 1.0, 0.0), Some(&initial)), motion);
    assert!(error < 0.2, "{error}");
}

#[test]
fn equal_pictures_have_no_flow() {
    for preset in PRESETS {
        let still = flow(preset, &picture(texture), None);
        assert!(still.values().iter().all(|flow| *flow == [0.0; 2]));
    }
}

#[test]
fn a_picture_without_texture_has_no_flow() {
    let (flat, brighter) = (vec![90; WIDTH * HEIGHT], vec![97; WIDTH * HEIGHT]);
    for preset in PRESETS {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        let found = engine.flow(view(&flat), view(&brighter), None).unwrap();
        assert!(found.values().iter().flatten().all(|value| value.abs() < 1e-3));
    }
}

#[test]
fn colour_and_grey_agree() {
    let (first, second) = (picture(texture), moved(Motion::shift(3.3, -1.7), 1.0, 0.0));
    let colour = |grey: &[u8]| grey.iter().flat_map(|value| [*value; 3]).collect::<Vec<u8>>();
    let (first_rgb, second_rgb) = (colour(&first), colour(&second));
    let mut engine = DenseFlow::new(FlowPreset::Medium, WIDTH, HEIGHT).unwrap();
    let grey = engine.flow(view(&first), view(&second), None).unwrap().clone();
    let rgb = |data| ImageView::rgb8(WIDTH, HEIGHT, data).unwrap();
    let colour = engine.flow(rgb(&first_rgb), rgb(&second_rgb), None).unwrap();
    for (a, b) in grey.values().iter().flatten().zip(colour.values().iter().flatten()) {
        assert!((a - b).abs() < 0.02, "{a} {b}");
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let motion = Motion { matrix: [[1.03, -0.02], [0.02, 1.03]], shift: [6.0, 1.0] };
    let second = moved(motion, 1.0, 0.0);
    for preset in PRESETS {
        let one = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| flow(preset, &second, None))
        };
        let expected = one(1);
        for threads in [2, 3, 7] {
            assert_eq!(one(threads), expected, "{preset:?} with {threads} threads");
        }
    }
}

#[test]
fn an_engine_forgets_its_last_pictures() {
    let (second, other) =
        (moved(Motion::shift(3.3, -1.7), 1.0, 0.0), moved(Motion::shift(-9.0, 6.0), 1.3, -20.0));
    let first = picture(texture);
    for preset in PRESETS {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        engine.flow(view(&other), view(&first), None).unwrap();
        assert_eq!(
            *engine.flow(view(&first), view(&second), None).unwrap(),
            flow(preset, &second, None)
        );
    }
}

#[test]
fn a_picture_of_another_size_or_format_is_refused() {
    let mut engine = DenseFlow::new(FlowPreset::Fast, WIDTH, HEIGHT).unwrap();
    let good = vec![0; WIDTH * HEIGHT];
    let small = ImageView::new(WIDTH, HEIGHT - 1, PixelFormat::Gray8, &good[WIDTH..]).unwrap();
    let error = engine.flow(view(&good), small, None).unwrap_err().to_string();
    assert!(error.contains("second picture is 200x119") && error.contains("200x120"), "{error}");
    let jpeg = ImageView::new(WIDTH, HEIGHT, PixelFormat::Mjpeg, &good).unwrap();
    assert!(matches!(
        engine.flow(jpeg, view(&good), None),
        Err(FlowError::Format { what: "the first picture", .. })
    ));
    let initial = FlowField::zero(WIDTH / 2, HEIGHT / 2);
    assert!(matches!(
        engine.flow(view(&good), view(&good), Some(&initial)),
        Err(FlowError::Size { .. })
    ));
    assert!(DenseFlow::new(FlowPreset::Fast, 7, 100).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_pictures_of_any_size_give_finite_flow(
        width in 8..70usize, height in 8..70usize, stride in 1..=8usize, finest in 0..=4usize, seed in any::<u32>(),
    ) {
        let noise = |salt: u32| -> Vec<u8> {
            (0..width * height).map(|i| {
                let hash = (i as u32 ^ seed).wrapping_mul(0x9E37_79B1).wrapping_add(salt);
                (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D).to_be_bytes()[0]
            }).collect()
        };
        let config = FlowConfig { patch_stride_px: stride, finest_scale: finest, ..FlowPreset::Fast.into() };
        let mut engine = DenseFlow::new(config, width, height).unwrap();
        let (first, second) = (noise(1), noise(2));
        let view = |data| ImageView::new(width, height, PixelFormat::Gray8, data).unwrap();
        let found = engine.flow(view(&first), view(&second), None).unwrap();
        prop_assert!(found.values().iter().flatten().all(|value| value.is_finite()));
    }

    #[test]
    fn predicted_flow_is_what_projection_says(
        axis in prop::array::uniform3(-0.2..0.2f64), shift in prop::array::uniform3(-0.3..0.3f64), depth in 0.6..9.0f64,
    ) {
        let camera = CameraModel::pinhole(40, 24, 1.4);
        let t_to_from = Pose3::from_parts(Translation3::from(shift), UnitQuaternion::from_scaled_axis(Vector3::from(axis)));
        let map = DepthMap::from_vec(40, 24, vec![depth as f32; 40 * 24]).unwrap();
        let (mut constant, mut from_map) = (FlowField::zero(40, 24), FlowField::zero(40, 24));
        predicted_flow(&camera, &t_to_from, DepthGuess::Constant(depth), &mut constant).unwrap();
        predicted_flow(&camera, &t_to_from, DepthGuess::Map(&map), &mut from_map).unwrap();
        for (index, (a, b)) in constant.values().iter().zip(from_map.values()).enumerate() {
            let (u, v) = ((index % 40) as f64, (index / 40) as f64);
            let (x, y) = camera.project(&(t_to_from * camera.unproject(u, v, depth))).unwrap();
            prop_assert!((f64::from(a[0]) - (x - u)).abs() < 1e-4 && (f64::from(a[1]) - (y - v)).abs() < 1e-4);
            prop_assert!((a[0] - b[0]).abs() < 1e-3 && (a[1] - b[1]).abs() < 1e-3);
        }
    }
}

#[test]
fn without_depth_only_the_rotation_is_predicted_and_behind_the_camera_nothing() {
    let camera = CameraModel::pinhole(40, 24, 1.4);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, 0.1, -0.03));
    let mut found = FlowField::zero(40, 24);
    let t_to_from = Pose3::from_parts(Translation3::new(5.0, 0.0, 1.0), turn);
    predicted_flow(&camera, &t_to_from, DepthGuess::Infinite, &mut found).unwrap();
    let (x, y) = camera.project(&(turn * camera.unproject(7.0, 3.0, 1.0))).unwrap();
    let [dx, dy] = found.values()[3 * 40 + 7];
    assert!((f64::from(dx) - (x - 7.0)).abs() < 1e-4 && (f64::from(dy) - (y - 3.0)).abs() < 1e-4);
    predicted_flow(
        &camera,
        &Pose3::translation(0.0, 0.0, -2.0),
        DepthGuess::Constant(1.0),
        &mut found,
    )
    .unwrap();
    assert!(found.values().iter().flatten().all(|value| value.is_nan()));
    assert!(
        predicted_flow(&camera, &t_to_from, DepthGuess::Infinite, &mut FlowField::zero(24, 40))
            .is_err()
    );
}

/// Mean end-point error of the flow between two pictures of the slanted plane, pixels.
fn plane_error_px(found: &FlowField, t_to_from: &Pose3) -> f64 {
    let camera = test_scene::camera();
    let (mut sum, mut count) = (0.0, 0.0);
    for (index, [dx, dy]) in found.values().iter().enumerate() {
        let (u, v) = ((index % camera.width) as f64, (index / camera.width) as f64);
        let point = camera.unproject(u, v, test_scene::slanted_depth_m(&Pose3::identity(), u, v));
        let (x, y) = camera.project(&(t_to_from * point)).unwrap();
        if x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64 {
            sum += (u + f64::from(*dx) - x).hypot(v + f64::from(*dy) - y);
            count += 1.0;
        }
    }
    sum / count
}

#[test]
fn a_turn_too_large_to_be_found_is_found_when_it_is_known() {
    let camera = test_scene::camera();
    // 0.5 rad: 40 of 160 pixels and more.
    let t_world_to = test_scene::pose([0.1, 0.0, 0.0], 0.5);
    let t_to_from = t_world_to.inverse();
    let first = test_scene::render(&camera, &Pose3::identity(), 1.0, 0.0);
    let second = test_scene::render(&camera, &t_world_to, 1.0, 0.0);
    let view =
        |data| ImageView::new(camera.width, camera.height, PixelFormat::Gray8, data).unwrap();
    let mut derotated = DerotatedFlow::new(FlowPreset::Medium, camera).unwrap();
    let turned = derotated.flow(view(&first), view(&second), &t_to_from.rotation).unwrap();
    let error = plane_error_px(turned, &t_to_from);
    assert!(error < 0.5, "derotated: {error}");
    let mut initial = FlowField::zero(camera.width, camera.height);
    predicted_flow(&camera, &t_to_from, DepthGuess::Constant(2.5), &mut initial).unwrap();
    let mut engine = DenseFlow::new(FlowPreset::Medium, camera.width, camera.height).unwrap();
    let blind = plane_error_px(engine.flow(view(&first), view(&second), None).unwrap(), &t_to_from);
    assert!(blind > 2.0 * error, "blind: {blind}");
}

/// Every second pixel of every second row.
fn read_flow(name: &str) -> Vec<[f32; 2]> {
    let path = format!("{}/tests/flow/{name}.i16", env!("CARGO_MANIFEST_DIR"));
    let bytes = std::fs::read(path).unwrap();
    let value = |pair: &[u8]| f32::from(i16::from_le_bytes([pair[0], pair[1]])) / 64.0;
    bytes.chunks_exact(4).map(|bytes| [value(&bytes[..2]), value(&bytes[2..])]).collect()
}

#[test]
fn the_error_is_not_above_that_of_opencv() {
    let read = |name: &str| {
        image::open(format!("{}/tests/flow/{name}.png", env!("CARGO_MANIFEST_DIR")))
            .unwrap()
            .into_luma8()
    };
    let (first, second) = (read("first"), read("second"));
    let (width, height) = (first.width() as usize, first.height() as usize);
    let truth = read_flow("truth");
    let mean_error = |flow: &mut dyn Iterator<Item = [f32; 2]>| {
        flow.zip(&truth).map(|(f, t)| (f[0] - t[0]).hypot(f[1] - t[1])).sum::<f32>()
            / truth.len() as f32
    };
    for (preset, name) in PRESETS.into_iter().zip(["ultra_fast", "fast", "medium"]) {
        let mut engine = DenseFlow::new(preset, width, height).unwrap();
        let view = |data| ImageView::new(width, height, PixelFormat::Gray8, data).unwrap();
        let found = engine.flow(view(&first), view(&second), None).unwrap().values();
        let rows = found.chunks_exact(width).step_by(2);
        let ours = mean_error(&mut rows.flat_map(|row| row.iter().step_by(2).copied()));
        let opencv = mean_error(&mut read_flow(&format!("opencv_{name}")).into_iter());
        assert!(ours <= 1.1 * opencv, "{preset:?}: ours {ours}, OpenCV {opencv}");
        println!("{preset:?}: ours {ours}, OpenCV {opencv}");
    }
}
