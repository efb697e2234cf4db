//! Tests of the whole front end: against analytic images, against OpenCV, and with invalid input.

use super::*;
use proptest::prelude::*;

const BARREL: Distortion = Distortion::PlumbBob([-0.25, 0.08, 0.002, -0.003, 0.01]);
const FORMATS: [PixelFormat; 4] =
    [PixelFormat::Rgb8, PixelFormat::Gray8, PixelFormat::Yuyv, PixelFormat::Nv12];

fn camera(width: usize, height: usize, focal: f64, distortion: Distortion) -> CameraModel {
    let cx = width as f64 / 2.0 - 1.0;
    let cy = height as f64 / 2.0 + 0.5;
    CameraModel { width, height, fx: focal, fy: focal * 1.02, cx, cy, distortion }
}

fn front_end(source: CameraModel, target: CameraModel, format: PixelFormat) -> FrontEnd {
    FrontEnd::new(source, target, format, YuvRange::Limited).unwrap()
}

fn view(camera: CameraModel, format: PixelFormat, data: &[u8]) -> ImageView<'_> {
    ImageView::new(camera.width, camera.height, format, data).unwrap()
}

fn rgb(front: &mut FrontEnd, frame: ImageView<'_>) -> Vec<u8> {
    let mut out = vec![77; 3 * front.target().width * front.target().height];
    front.to_rgb(frame, &mut out).unwrap();
    out
}

/// Noise that is the same in every run of the test.
fn noise(bytes: usize) -> Vec<u8> {
    (0..bytes as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect()
}

/// The RGB image of a camera in a world whose brightness at each undistorted ray is `shade`.
fn seen(camera: &CameraModel, shade: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let shades = (0..camera.width * camera.height).map(|index| {
        let undistorted = camera.ray((index % camera.width) as f64, (index / camera.width) as f64);
        let mut x = undistorted.x;
        let mut y = undistorted.y;
        // The inverse of the lens by fixed-point iteration.
        for _ in 0..100 {
            let (dx, dy) = camera.distortion.distort(x, y);
            x = x + undistorted.x - dx;
            y = y + undistorted.y - dy;
        }
        shade(x, y).clamp(0.0, 255.0).round() as u8
    });
    shades.flat_map(|shade| [shade; 3]).collect()
}

#[test]
fn a_constant_colour_stays_constant_through_every_lens_and_size() {
    let lenses = [Distortion::None, BARREL, Distortion::Fisheye([0.05, -0.02, 0.004, -0.001])];
    for distortion in lenses {
        for (width, height) in [(64, 48), (32, 20), (101, 33), (8, 4)] {
            let source = camera(96, 64, 90.0, distortion);
            let target =
                CameraModel { distortion: Distortion::None, ..source }.resized(width, height);
            let mut front = front_end(source, target, PixelFormat::Rgb8);
            let data = [10, 200, 255].repeat(96 * 64);
            let out = rgb(&mut front, view(source, PixelFormat::Rgb8, &data));
            for (pixel, valid) in out.chunks_exact(3).zip(front.valid()) {
                assert_eq!(pixel, if *valid { [10, 200, 255] } else { [0; 3] });
            }
            assert!(front.valid().iter().filter(|valid| **valid).count() * 2 > front.valid().len());
        }
    }
}

#[test]
fn the_same_camera_changes_nothing() {
    let source = camera(70, 34, 60.0, Distortion::None);
    let data = noise(3 * 70 * 34);
    let mut front = front_end(source, source, PixelFormat::Rgb8);
    assert_eq!(front.crop, Some((0, 0)));
    assert_eq!(rgb(&mut front, view(source, PixelFormat::Rgb8, &data)), data);
}

#[test]
fn the_crop_and_the_remapping_agree() {
    for format in FORMATS {
        let source = camera(96, 64, 60.0, Distortion::None);
        let data = noise(format.bytes(96, 64).unwrap());
        for (left, top) in [(0.0, 0.0), (10.0, 7.0), (11.0, 16.0), (26.0, 34.0)] {
            let mut short = front_end(source, source.cropped(left, top, 70, 30), format);
            let mut long = FrontEnd {
                crop: None,
                packed: vec![0; short.remap.source_pixels()],
                ..short.clone()
            };
            let frame = view(source, format, &data);
            assert!(
                rgb(&mut short, frame) == rgb(&mut long, frame),
                "{format:?} from {left}, {top}"
            );
        }
    }
}

#[test]
fn a_ramp_shifted_by_part_of_a_pixel_is_exact_to_a_32nd() {
    let source = camera(40, 30, 50.0, Distortion::None);
    let ramp: Vec<u8> =
        (0..40 * 30).flat_map(|i| [(i % 40 * 6) as u8, (i / 40 * 8) as u8, 0]).collect();
    for shift in [0.1, 0.25, 0.4, 0.77] {
        let target = source.cropped(3.0 + shift, 2.0 + shift, 30, 20);
        let out = rgb(
            &mut front_end(source, target, PixelFormat::Rgb8),
            view(source, PixelFormat::Rgb8, &ramp),
        );
        for (index, pixel) in out.chunks_exact(3).enumerate() {
            let u = (index % 30) as f64 + 3.0 + shift;
            let v = (index / 30) as f64 + 2.0 + shift;
            // Half a 32nd of a pixel at the ramp's slope, and half a grey level.
            assert!((f64::from(pixel[0]) - 6.0 * u).abs() <= 6.0 / 64.0 + 0.5);
            assert!((f64::from(pixel[1]) - 8.0 * v).abs() <= 8.0 / 64.0 + 0.5);
        }
    }
}

#[test]
fn undistortion_straightens_lines() {
    for distortion in [BARREL, Distortion::Fisheye([0.05, -0.02, 0.004, -0.001])] {
        let source = camera(640, 480, 450.0, distortion);
        let target = CameraModel {
            distortion: Distortion::None,
            ..camera(500, 380, 450.0, Distortion::None)
        };
        let mut front = front_end(source, target, PixelFormat::Rgb8);
        for at in [-0.45, -0.2, 0.05, 0.3, 0.5] {
            let upright = seen(&source, |x, _| {
                // A bar, narrow enough to have a well-defined middle and wide enough to be sampled well.
                255.0 * (-((x - at) / 0.012).powi(2)).exp()
            });
            let out = rgb(&mut front, view(source, PixelFormat::Rgb8, &upright));
            for row in out.chunks_exact(3 * 500) {
                let weight: f64 = row.iter().step_by(3).map(|value| f64::from(*value)).sum();
                let moment: f64 = row
                    .iter()
                    .step_by(3)
                    .enumerate()
                    .map(|(column, value)| column as f64 * f64::from(*value))
                    .sum();
                let expected = target.fx * at + target.cx;
                assert!(
                    (moment / weight - expected).abs() < 0.1,
                    "{distortion:?}: {} is not {expected}",
                    moment / weight
                );
            }
        }
    }
}

#[test]
fn halving_again_and_again_is_the_mean_of_the_pixels() {
    let source = CameraModel::pinhole(64, 64, 1.0);
    let data = noise(64 * 64);
    let mut front = front_end(source, source.resized(8, 16), PixelFormat::Gray8);
    assert_eq!(front.mean_of, (4, 2));
    let out = rgb(&mut front, view(source, PixelFormat::Gray8, &data));
    for (index, pixel) in out.chunks_exact(3).enumerate() {
        let left = index % 8 * 8;
        let top = index / 8 * 4;
        let block = (0..4).flat_map(|dy| (0..8).map(move |dx| (top + dy) * 64 + left + dx));
        let mean = block.map(|at| f64::from(data[at])).sum::<f64>() / 32.0;
        // The result is rounded twice.
        assert!((f64::from(pixel[0]) - mean).abs() <= 1.0);
    }
}

#[test]
fn a_fine_checkerboard_becomes_grey_without_aliasing() {
    let source = CameraModel::pinhole(1280, 720, 1.2);
    let board: Vec<u8> =
        (0..1280 * 720).map(|i| if (i % 1280 + i / 1280) % 2 == 0 { 255 } else { 0 }).collect();
    for (width, height) in [(320, 180), (500, 100), (300, 200), (16, 9)] {
        let mut front = front_end(source, source.resized(width, height), PixelFormat::Gray8);
        let out = rgb(&mut front, view(source, PixelFormat::Gray8, &board));
        assert!(out.iter().all(|value| (126..=130).contains(value)), "{width}x{height}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let source = camera(320, 240, 260.0, BARREL);
    let target = camera(200, 111, 170.0, Distortion::None);
    let data = noise(2 * 320 * 240);
    let [one, two, five] = [1, 2, 5].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            rgb(
                &mut front_end(source, target, PixelFormat::Yuyv),
                view(source, PixelFormat::Yuyv, &data),
            )
        })
    });
    assert!(two == one && five == one);
}

#[test]
fn a_call_allocates_nothing() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        for format in FORMATS {
            let source = camera(96, 64, 90.0, BARREL);
            for target in [
                source.resized(30, 10),
                source.cropped(0.0, 0.0, 40, 40),
                camera(200, 100, 99.0, BARREL),
            ] {
                let target = CameraModel { distortion: Distortion::None, ..target };
                let mut front = front_end(source, target, format);
                let data = noise(format.bytes(96, 64).unwrap());
                let frame = view(source, format, &data);
                let mut bytes = rgb(&mut front, frame);
                let count =
                    allocation_counter::measure(|| front.to_rgb(frame, &mut bytes).unwrap());
                assert_eq!(count.count_total, 0, "{format:?}");
            }
        }
    });
}

#[test]
fn only_the_jpeg_decoder_allocates() {
    let source = opencv::source(Distortion::None);
    let mut front = front_end(source, source, PixelFormat::Mjpeg);
    let frame = view(source, PixelFormat::Mjpeg, opencv::JPEG);
    let mut out = rgb(&mut front, frame);
    let count = allocation_counter::measure(|| front.to_rgb(frame, &mut out).unwrap());
    // Tables and one row of blocks, much less than an image (18,432 bytes here) times the frames of a day.
    assert!(count.count_total > 0 && count.count_current == 0, "{count:?}");
}

/// Comparison with the results of OpenCV 5.0, from tests/fixtures/make_imaging.py.
mod opencv {
    use super::*;

    macro_rules! fixture {
        ($name:literal) => {
            include_bytes!(concat!("../../tests/imaging/", $name))
        };
    }

    const YUYV: &[u8] = fixture!("scene.yuyv");
    const NV12: &[u8] = fixture!("scene.nv12");
    pub const JPEG: &[u8] = fixture!("scene.jpg");
    const FISHEYE: Distortion = Distortion::Fisheye([0.05, -0.02, 0.004, -0.001]);

    pub fn source(distortion: Distortion) -> CameraModel {
        CameraModel { width: 96, height: 64, fx: 70.0, fy: 72.0, cx: 47.0, cy: 32.5, distortion }
    }

    fn target() -> CameraModel {
        let distortion = Distortion::None;
        CameraModel { width: 80, height: 40, fx: 66.0, fy: 66.0, cx: 39.5, cy: 19.5, distortion }
    }

    /// Largest and mean difference where the image is valid.
    fn difference(ours: &[u8], theirs: &[u8], valid: &[bool]) -> (u8, f64) {
        assert_eq!(ours.len(), theirs.len());
        let pairs = ours.iter().zip(theirs).enumerate().filter(|(index, _)| valid[index / 3]);
        let differences: Vec<u8> = pairs.map(|(_, (a, b))| a.abs_diff(*b)).collect();
        let mean =
            differences.iter().map(|d| f64::from(*d)).sum::<f64>() / differences.len() as f64;
        (differences.into_iter().max().unwrap(), mean)
    }

    fn compare(
        distortion: Distortion,
        format: PixelFormat,
        data: &[u8],
        theirs: &[u8],
    ) -> (u8, f64) {
        let mut front = front_end(source(distortion), target(), format);
        assert!(front.valid().iter().all(|valid| *valid), "the fixture has no border");
        let ours = rgb(&mut front, view(source(distortion), format, data));
        difference(&ours, theirs, front.valid())
    }

    #[test]
    fn conversion_alone_differs_from_opencv_by_rounding() {
        let camera = source(Distortion::None);
        let mut front = front_end(camera, camera, PixelFormat::Yuyv);
        let ours = rgb(&mut front, view(camera, PixelFormat::Yuyv, YUYV));
        let (largest, mean) = difference(&ours, fixture!("yuyv_converted.rgb"), front.valid());
        assert!(largest <= 1 && mean < 0.1, "{largest} {mean}");
    }

    #[test]
    fn conversion_and_undistortion_differ_from_opencv_by_rounding() {
        for (distortion, format, data, theirs) in [
            (BARREL, PixelFormat::Yuyv, YUYV, &fixture!("yuyv_plumb_bob.rgb")[..]),
            (FISHEYE, PixelFormat::Yuyv, YUYV, fixture!("yuyv_fisheye.rgb")),
            (BARREL, PixelFormat::Nv12, NV12, fixture!("nv12_plumb_bob.rgb")),
        ] {
            let (largest, mean) = compare(distortion, format, data, theirs);
            assert!(largest <= 3 && mean < 0.5, "{format:?} {distortion:?}: {largest} {mean}");
        }
    }

    #[test]
    fn jpeg_differs_from_opencv_by_the_decoders_rounding() {
        let (largest, mean) =
            compare(BARREL, PixelFormat::Mjpeg, JPEG, fixture!("jpeg_plumb_bob.rgb"));
        assert!(largest <= 5 && mean < 0.6, "{largest} {mean}");
    }

    #[test]
    fn a_truncated_jpeg_is_an_error_and_does_not_change_the_output() {
        let camera = source(Distortion::None);
        let mut front = front_end(camera, target(), PixelFormat::Mjpeg);
        for length in 0..JPEG.len() {
            let mut out = vec![77; 3 * 80 * 40];
            let outcome = front.to_rgb(view(camera, PixelFormat::Mjpeg, &JPEG[..length]), &mut out);
            assert!(matches!(outcome, Err(ImagingError::Jpeg { .. })), "{length}: {outcome:?}");
            assert!(out.iter().all(|byte| *byte == 77));
        }
    }

    #[test]
    fn a_jpeg_of_another_size_is_refused_with_both_sizes() {
        for (width, height) in [(95, 64), (96, 63), (640, 480), (32, 32)] {
            let camera = CameraModel::pinhole(width, height, 1.0);
            let mut front = front_end(camera, camera, PixelFormat::Mjpeg);
            let mut out = vec![0; 3 * width * height];
            let error = front
                .to_rgb(view(camera, PixelFormat::Mjpeg, JPEG), &mut out)
                .unwrap_err()
                .to_string();
            assert!(error.contains("96") && error.contains(&width.to_string()), "{error}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn a_corrupted_jpeg_never_panics(
            changes in proptest::collection::vec((0..JPEG.len(), 0_u8..), 1..20), length in 0..=JPEG.len(),
        ) {
            let mut data = JPEG.to_vec();
            changes.into_iter().for_each(|(at, byte)| data[at] = byte);
            let camera = source(Distortion::None);
            let mut front = front_end(camera, target(), PixelFormat::Mjpeg);
            let mut out = vec![0; 3 * 80 * 40];
            _ = front.to_rgb(view(camera, PixelFormat::Mjpeg, &data), &mut out);
            _ = front.to_rgb(view(camera, PixelFormat::Mjpeg, &data[..length]), &mut out);
        }
    }
}

fn refused(source: CameraModel, target: CameraModel, format: PixelFormat) -> String {
    FrontEnd::new(source, target, format, YuvRange::Full).unwrap_err().to_string()
}

#[test]
fn invalid_cameras_are_refused_with_a_reason() {
    let good = CameraModel::pinhole(64, 48, 1.0);
    let rgb8 = PixelFormat::Rgb8;
    assert!(
        refused(CameraModel { fx: f64::NAN, ..good }, good, rgb8).starts_with("the source camera")
    );
    assert!(refused(good, CameraModel { width: 0, ..good }, rgb8).starts_with("the target camera"));
    assert!(refused(CameraModel { width: 1, ..good }, good, rgb8).starts_with("the source camera"));
    assert!(
        refused(good, CameraModel { distortion: BARREL, ..good }, rgb8).contains("no distortion")
    );
    assert!(refused(CameraModel { width: 63, ..good }, good, PixelFormat::Yuyv).contains("63x48"));
    assert!(refused(CameraModel { height: 47, ..good }, good, PixelFormat::Nv12).contains("64x47"));
    assert!(refused(good, CameraModel { cx: 1e6, ..good }, rgb8).contains("no pixel"));
}

#[test]
fn a_frame_or_output_of_another_size_is_refused() {
    let source = CameraModel::pinhole(64, 48, 1.0);
    let mut front = front_end(source, source.resized(32, 24), PixelFormat::Gray8);
    let mut out = vec![0; 3 * 32 * 24];
    let small = ImageView::new(32, 24, PixelFormat::Gray8, &[0; 32 * 24]).unwrap();
    assert!(matches!(
        front.to_rgb(small, &mut out),
        Err(ImagingError::Frame { found_width: 32, .. })
    ));
    let yuyv = vec![0; 64 * 48 * 2];
    assert!(front.to_rgb(view(source, PixelFormat::Yuyv, &yuyv), &mut out).is_err());
    let grey = vec![0; 64 * 48];
    let grey = view(source, PixelFormat::Gray8, &grey);
    assert!(matches!(front.to_rgb(grey, &mut out[1..]), Err(ImagingError::Output { .. })));
}

fn any_lens() -> impl Strategy<Value = Distortion> {
    let plumb_bob = proptest::array::uniform5(-1.0..1.0).prop_map(Distortion::PlumbBob);
    let fisheye = proptest::array::uniform4(-1.0..1.0).prop_map(Distortion::Fisheye);
    prop_oneof![Just(Distortion::None), plumb_bob, fisheye]
}

fn any_camera() -> impl Strategy<Value = CameraModel> {
    (1_usize..140, 1_usize..90, 0.1..300.0, 0.1..300.0, -50.0..200.0, -50.0..150.0, any_lens())
        .prop_map(|(width, height, fx, fy, cx, cy, distortion)| CameraModel {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion,
        })
}

proptest! {
    #[test]
    fn any_cameras_and_bytes_give_an_image_or_an_error_but_never_a_panic(
        source in any_camera(), target in any_camera(), format in proptest::sample::select(&FORMATS[..]), seed: u8,
    ) {
        let target = CameraModel { distortion: Distortion::None, ..target };
        if let Ok(mut front) = FrontEnd::new(source, target, format, YuvRange::Full) {
            let data: Vec<u8> = noise(format.bytes(source.width, source.height).unwrap()).iter().map(|b| b ^ seed).collect();
            let out = rgb(&mut front, view(source, format, &data));
            for (pixel, valid) in out.chunks_exact(3).zip(front.valid()) {
                prop_assert!(*valid || pixel == [0; 3]);
            }
        }
    }

    #[test]
    fn random_bytes_are_no_jpeg(data in proptest::collection::vec(0_u8.., 0..200)) {
        let camera = CameraModel::pinhole(16, 16, 1.0);
        let mut front = front_end(camera, camera, PixelFormat::Mjpeg);
        prop_assert!(front.to_rgb(view(camera, PixelFormat::Mjpeg, &data), &mut [0; 768]).is_err());
    }
}
