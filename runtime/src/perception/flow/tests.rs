//! Tests on images whose flow is known.

use hal::{ImageView, PixelFormat};
use proptest::prelude::*;

use super::*;

const WIDTH: usize = 200;
const HEIGHT: usize = 120;
const PRESETS: [FlowPreset; 3] = [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium];

/// Motion of a position from the first image to the second: `matrix * (position - middle) + middle + shift`.
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
        let mx = WIDTH as f32 / 2.0;
        let my = HEIGHT as f32 / 2.0;
        let x = x - mx;
        let y = y - my;
        let [[a, b], [c, d]] = self.matrix;
        [a * x + b * y + mx + self.shift[0], c * x + d * y + my + self.shift[1]]
    }

    fn inverse(&self, x: f32, y: f32) -> [f32; 2] {
        let mx = WIDTH as f32 / 2.0;
        let my = HEIGHT as f32 / 2.0;
        let x = x - mx - self.shift[0];
        let y = y - my - self.shift[1];
        let [[a, b], [c, d]] = self.matrix;
        let determinant = a * d - b * c;
        [(d * x - b * y) / determinant + mx, (a * y - c * x) / determinant + my]
    }
}

/// A texture without cells or edges: waves of many directions and lengths (5 to 60 pixels).
fn texture(x: f32, y: f32) -> f32 {
    (0..24).fold(128.0, |sum, wave| {
        let wave = wave as f32;
        let angle = wave * 2.4;
        let length = 5.0 * 1.115_f32.powf(wave);
        let along = x * angle.cos() + y * angle.sin();
        sum + 3.5
            * (length / 12.0).sqrt()
            * (along * std::f32::consts::TAU / length + wave * wave).sin()
    })
}

fn image(grey: impl Fn(f32, f32) -> f32) -> Vec<u8> {
    (0..WIDTH * HEIGHT)
        .map(|i| grey((i % WIDTH) as f32, (i / WIDTH) as f32).round().clamp(0.0, 255.0) as u8)
        .collect()
}

fn moved(motion: Motion, gain: f32, offset: f32) -> Vec<u8> {
    image(|x, y| {
        let [x, y] = motion.inverse(x, y);
        gain * texture(x, y) + offset
    })
}

fn view(data: &[u8]) -> ImageView<'_> {
    ImageView::new(WIDTH, HEIGHT, PixelFormat::Gray8, data).unwrap()
}

/// Mean end-point error of pixels that stay in the image, pixels.
fn error_px(flow: &FlowField, motion: Motion) -> f32 {
    let mut sum = 0.0;
    let mut count = 0.0;
    for (index, [dx, dy]) in flow.values().iter().enumerate() {
        let x = (index % WIDTH) as f32;
        let y = (index / WIDTH) as f32;
        let [tx, ty] = motion.apply(x, y);
        if tx >= 0.0 && ty >= 0.0 && tx < WIDTH as f32 && ty < HEIGHT as f32 {
            sum += (x + dx - tx).hypot(y + dy - ty);
            count += 1.0;
        }
    }
    sum / count
}

fn flow(preset: FlowPreset, second: &[u8]) -> FlowField {
    let first = image(texture);
    let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
    engine.flow(view(&first), view(second)).unwrap().clone()
}

#[test]
fn a_shifted_image_gives_its_shift() {
    for (preset, bound_px) in PRESETS.into_iter().zip([0.2, 0.1, 0.08]) {
        for motion in
            [Motion::shift(0.5, 0.25), Motion::shift(3.3, -1.7), Motion::shift(-11.0, 4.6)]
        {
            let error = error_px(&flow(preset, &moved(motion, 1.0, 0.0)), motion);
            assert!(error < bound_px, "{preset:?} {:?}: {error}", motion.shift);
        }
    }
}

#[test]
fn a_turned_and_grown_image_gives_its_affine_flow() {
    let motion = Motion { matrix: [[1.03, -0.02], [0.02, 1.03]], shift: [2.0, 1.0] };
    for (preset, bound_px) in PRESETS.into_iter().zip([0.35, 0.25, 0.1]) {
        let error = error_px(&flow(preset, &moved(motion, 1.0, 0.0)), motion);
        assert!(error < bound_px, "{preset:?}: {error}");
    }
}

#[test]
fn another_exposure_changes_little() {
    let motion = Motion::shift(3.3, -1.7);
    for (preset, bound_px) in PRESETS.into_iter().zip([0.25, 0.25, 0.15]) {
        let error = error_px(&flow(preset, &moved(motion, 1.15, 4.0)), motion);
        assert!(error < bound_px, "{preset:?}: {error}");
    }
}

#[test]
fn equal_images_have_no_flow() {
    for preset in PRESETS {
        let still = flow(preset, &image(texture));
        assert!(still.values().iter().all(|flow| *flow == [0.0; 2]));
    }
}

#[test]
fn an_image_without_texture_has_no_flow() {
    let flat = vec![90; WIDTH * HEIGHT];
    let brighter = vec![97; WIDTH * HEIGHT];
    for preset in PRESETS {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        let found = engine.flow(view(&flat), view(&brighter)).unwrap();
        assert!(found.values().iter().flatten().all(|value| value.abs() < 1e-3));
    }
}

#[test]
fn colour_and_grey_agree() {
    fn as_rgb(grey: &[u8]) -> Vec<u8> {
        grey.iter().flat_map(|value| [*value; 3]).collect()
    }

    let first = image(texture);
    let second = moved(Motion::shift(3.3, -1.7), 1.0, 0.0);
    let first_rgb = as_rgb(&first);
    let second_rgb = as_rgb(&second);
    let mut engine = DenseFlow::new(FlowPreset::Medium, WIDTH, HEIGHT).unwrap();
    let grey = engine.flow(view(&first), view(&second)).unwrap().clone();
    let first_rgb = ImageView::rgb8(WIDTH, HEIGHT, &first_rgb).unwrap();
    let second_rgb = ImageView::rgb8(WIDTH, HEIGHT, &second_rgb).unwrap();
    let colour = engine.flow(first_rgb, second_rgb).unwrap();
    for (a, b) in grey.values().iter().flatten().zip(colour.values().iter().flatten()) {
        assert!((a - b).abs() < 0.02, "{a} {b}");
    }
}

fn flow_on(threads: usize, preset: FlowPreset, second: &[u8]) -> FlowField {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| flow(preset, second))
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let motion = Motion { matrix: [[1.03, -0.02], [0.02, 1.03]], shift: [6.0, 1.0] };
    let second = moved(motion, 1.0, 0.0);
    for preset in PRESETS {
        let expected = flow_on(1, preset, &second);
        for threads in [2, 3, 7] {
            assert_eq!(
                flow_on(threads, preset, &second),
                expected,
                "{preset:?} with {threads} threads"
            );
        }
    }
}

#[test]
fn a_result_does_not_depend_on_the_images_before() {
    let second = moved(Motion::shift(3.3, -1.7), 1.0, 0.0);
    let other = moved(Motion::shift(-9.0, 6.0), 1.3, -20.0);
    let first = image(texture);
    for preset in PRESETS {
        let mut engine = DenseFlow::new(preset, WIDTH, HEIGHT).unwrap();
        engine.flow(view(&other), view(&first)).unwrap();
        assert_eq!(*engine.flow(view(&first), view(&second)).unwrap(), flow(preset, &second));
    }
}

#[test]
fn an_image_of_another_size_or_format_is_refused() {
    let mut engine = DenseFlow::new(FlowPreset::Fast, WIDTH, HEIGHT).unwrap();
    let good = vec![0; WIDTH * HEIGHT];
    let small = ImageView::new(WIDTH, HEIGHT - 1, PixelFormat::Gray8, &good[WIDTH..]).unwrap();
    let error = engine.flow(view(&good), small).unwrap_err().to_string();
    assert!(error.contains("second image is 200x119") && error.contains("200x120"), "{error}");
    let jpeg = ImageView::new(WIDTH, HEIGHT, PixelFormat::Mjpeg, &good).unwrap();
    assert!(matches!(
        engine.flow(jpeg, view(&good)),
        Err(FlowError::Format { what: "the first image", .. })
    ));
    assert!(DenseFlow::new(FlowPreset::Fast, 7, 100).is_err());
}

fn noise(pixels: usize, seed: u32, salt: u32) -> Vec<u8> {
    let hash = (0..pixels).map(|i| (i as u32 ^ seed).wrapping_mul(0x9E37_79B1).wrapping_add(salt));
    hash.map(|hash| (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D).to_be_bytes()[0]).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_images_of_any_size_give_finite_flow(
        width in 8..70usize, height in 8..70usize, stride in 1..=8usize, finest in 0..=4usize, seed in any::<u32>(),
    ) {
        let config = FlowConfig { patch_stride_px: stride, finest_scale: finest, ..FlowPreset::Fast.into() };
        let mut engine = DenseFlow::new(config, width, height).unwrap();
        let first = noise(width * height, seed, 1);
        let second = noise(width * height, seed, 2);
        let first = ImageView::new(width, height, PixelFormat::Gray8, &first).unwrap();
        let second = ImageView::new(width, height, PixelFormat::Gray8, &second).unwrap();
        let found = engine.flow(first, second).unwrap();
        prop_assert!(found.values().iter().flatten().all(|value| value.is_finite()));
    }
}

/// Flow of every second pixel of every second row, from a fixture of `tests/fixtures/make_flow.py`.
fn read_flow(name: &str) -> Vec<[f32; 2]> {
    let path = format!("{}/tests/flow/{name}.i16", env!("CARGO_MANIFEST_DIR"));
    let bytes = std::fs::read(path).unwrap();
    let values =
        bytes.chunks_exact(2).map(|pair| f32::from(i16::from_le_bytes([pair[0], pair[1]])));
    let values: Vec<f32> = values.map(|value| value / 64.0).collect();
    values.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
}

fn read_grey(name: &str) -> image::GrayImage {
    let path = format!("{}/tests/flow/{name}.png", env!("CARGO_MANIFEST_DIR"));
    image::open(path).unwrap().into_luma8()
}

fn mean_error_px(flow: impl Iterator<Item = [f32; 2]>, truth: &[[f32; 2]]) -> f32 {
    let errors = flow.zip(truth).map(|(f, t)| (f[0] - t[0]).hypot(f[1] - t[1]));
    errors.sum::<f32>() / truth.len() as f32
}

#[test]
fn the_error_is_not_above_that_of_opencv() {
    let first = read_grey("first");
    let second = read_grey("second");
    let (width, height) = (first.width() as usize, first.height() as usize);
    let first = ImageView::new(width, height, PixelFormat::Gray8, &first).unwrap();
    let second = ImageView::new(width, height, PixelFormat::Gray8, &second).unwrap();
    let truth = read_flow("truth");
    for (preset, name) in PRESETS.into_iter().zip(["ultra_fast", "fast", "medium"]) {
        let mut engine = DenseFlow::new(preset, width, height).unwrap();
        let found = engine.flow(first, second).unwrap().values();
        let rows = found.chunks_exact(width).step_by(2);
        let ours = mean_error_px(rows.flat_map(|row| row.iter().step_by(2).copied()), &truth);
        let opencv = mean_error_px(read_flow(&format!("opencv_{name}")).into_iter(), &truth);
        assert!(ours <= 1.1 * opencv, "{preset:?}: ours {ours}, OpenCV {opencv}");
        println!("{preset:?}: ours {ours}, OpenCV {opencv}");
    }
}
