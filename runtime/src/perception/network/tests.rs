//! Tests with the real ONNX Runtime and the models of `tests/fixtures/make_models.py`.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use hal::{CameraModel, DepthMap, ImageView, PixelFormat, Pose2, Pose3};
use ort::environment::Environment;

use super::*;
use crate::recording::RgbImage;
use crate::robot::{DepthSource, Robot, RobotConfig, test_robot};
use crate::session::recompute;

const SIZE: (usize, usize) = (8, 4);
const PIXELS: usize = 32;

/// ONNX Runtime allows one environment in a process.
static ONNX_RUNTIME: LazyLock<Environment> = LazyLock::new(|| {
    let library = onnx_runtime_library()
        .expect("no ONNX Runtime: run `cargo xtask setup`, or set ORT_DYLIB_PATH");
    ort::init_from(library)
        .expect("ONNX Runtime does not load")
        .with_telemetry(false)
        .build()
        .unwrap()
});

fn onnx_runtime_library() -> Option<PathBuf> {
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH") {
        return Some(path.into());
    }
    let installed = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/onnxruntime");
    let mut files = std::fs::read_dir(installed).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    files.find(|path| path.to_string_lossy().contains("libonnxruntime.so"))
}

fn model(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/models/{name}.onnx"));
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn load(name: &str) -> Result<DepthNetwork, NetworkError> {
    DepthNetwork::load(&ONNX_RUNTIME, &model(name), &camera(SIZE), NetworkOptions::default())
}

fn camera((width, height): (usize, usize)) -> CameraModel {
    CameraModel::pinhole(width, height, std::f64::consts::FRAC_PI_2)
}

fn plain(colour: [u8; 3]) -> Vec<u8> {
    colour.repeat(PIXELS)
}

fn view(bytes: &[u8]) -> ImageView<'_> {
    ImageView::rgb8(SIZE.0, SIZE.1, bytes).unwrap()
}

/// Depth by the formula of Monodepth2.
fn depth_of(x: f32, (min, max): (f32, f32)) -> f32 {
    1.0 / (1.0 / max + (1.0 / min - 1.0 / max) * x)
}

fn assert_close(found: f32, expected: f32) {
    assert!((found - expected).abs() <= 1e-4 * expected.abs(), "{found} instead of {expected}");
}

#[test]
fn every_pixel_has_the_depth_that_the_disparity_formula_gives_its_own_colour() {
    let mut network = load("mean").unwrap();
    let bytes: Vec<u8> = (0..3 * PIXELS).map(|i| (i * 37 % 256) as u8).collect();
    let estimate = network.estimate(view(&bytes), &Pose3::identity(), None).unwrap();
    for (pixel, &depth) in bytes.chunks_exact(3).zip(estimate.depth.values()) {
        let mean = pixel.iter().map(|&byte| f32::from(byte) / 255.0).sum::<f32>() / 3.0;
        assert_close(depth, depth_of(mean, DEFAULT_DEPTH_RANGE_M));
    }
    assert!(estimate.confidence.iter().all(|&confidence| confidence > 0.0));
}

#[test]
fn black_is_the_far_end_and_white_the_near_end_of_the_models_own_range() {
    let mut network = load("mean_1_to_5_m").unwrap();
    assert_eq!(network.spec().version.as_deref(), Some("fixture-7"));
    for (colour, depth_m) in [([0; 3], 5.0), ([255; 3], 1.0)] {
        let frame = plain(colour);
        let estimate = network.estimate(view(&frame), &Pose3::identity(), None).unwrap();
        assert_close(estimate.depth.get(3, 2).unwrap(), depth_m);
    }
}

#[test]
fn red_green_and_blue_arrive_in_this_order() {
    let mut network = load("weighted").unwrap();
    for (colour, x) in
        [([255, 0, 0], 0.1), ([0, 255, 0], 0.2), ([0, 0, 255], 0.4), ([51, 102, 204], 0.42)]
    {
        let estimate = network.estimate(view(&plain(colour)), &Pose3::identity(), None).unwrap();
        assert_close(estimate.depth.get(0, 0).unwrap(), depth_of(x, DEFAULT_DEPTH_RANGE_M));
    }
}

#[test]
fn a_depth_output_is_used_unchanged_within_the_models_range() {
    let mut network = load("metres").unwrap();
    let estimate = network.estimate(view(&plain([9, 51, 7])), &Pose3::identity(), None).unwrap();
    assert_close(estimate.depth.get(7, 3).unwrap(), 2.2);
    // 2 + 1 m is beyond the 2.8 m that it promises.
    assert_eq!(
        network.estimate(view(&plain([0, 255, 0])), &Pose3::identity(), None),
        Err(NoDepth::NetworkOutput)
    );
}

#[test]
fn dynamic_sizes_in_the_model_take_the_cameras() {
    let mut network = load("any_size").unwrap();
    assert_eq!(network.spec().size, SIZE);
    assert!(network.estimate(view(&plain([10; 3])), &Pose3::identity(), None).is_ok());
}

fn coarse_with_a_hole() -> DepthEstimate {
    let mut depth_m: Vec<f32> = (0..PIXELS).map(|i| 0.5 + 0.25 * i as f32).collect();
    depth_m[5] = 0.0;
    let mut confidence = vec![0.75; PIXELS];
    confidence[5] = 0.0;
    DepthEstimate { depth: DepthMap::from_vec(SIZE.0, SIZE.1, depth_m).unwrap(), confidence }
}

#[test]
fn coarse_depth_passes_through_a_model_that_copies_it() {
    let coarse = coarse_with_a_hole();
    for name in ["coarse_second_input", "coarse_six_channels"] {
        let mut network = load(name).unwrap();
        assert!(network.spec().input.takes_coarse());
        let estimate =
            network.estimate(view(&plain([128; 3])), &Pose3::identity(), Some(&coarse)).unwrap();
        for (pixel, &depth) in coarse.depth.values().iter().enumerate() {
            assert_close(estimate.depth.values()[pixel], if depth > 0.0 { depth } else { 20.0 });
        }
        // Laplace scale 0.1 where coarse depth is known, 1 elsewhere.
        for (pixel, scale) in [(4, 0.1_f32), (5, 1.0)] {
            let within_delta1 = 1.0 - (-(1.25_f32.ln()) / scale).exp();
            assert_close(estimate.confidence[pixel], within_delta1);
        }
    }
}

#[test]
fn depth_that_was_not_seen_keeps_a_confidence_below_what_the_map_takes() {
    let seen = coarse_with_a_hole();
    let mut network = load("mean").unwrap();
    network.estimate(view(&plain([128; 3])), &Pose3::identity(), None).unwrap();
    assert!(network.last().confidence.iter().all(|confidence| *confidence == 1.0));
    network.doubt_unseen(Some(&seen));
    for (confidence, depth) in network.last().confidence.iter().zip(seen.depth.values()) {
        assert_eq!(*confidence, if *depth > 0.0 { 1.0 } else { 0.75 });
    }
    network.doubt_unseen(None);
    assert!(network.last().confidence.iter().all(|confidence| *confidence == 0.75));
}

#[test]
fn coarse_depth_changes_nothing_for_a_model_without_that_input() {
    let mut network = load("mean").unwrap();
    assert_eq!(
        network.last(),
        &DepthEstimate::none(SIZE.0, SIZE.1),
        "nothing is left of the run at loading"
    );
    let frame = plain([128, 64, 32]);
    let without = network.estimate(view(&frame), &Pose3::identity(), None).unwrap().clone();
    assert_eq!(
        network.estimate(view(&frame), &Pose3::identity(), Some(&coarse_with_a_hole())),
        Ok(&without)
    );
    assert_eq!(network.last(), &without);
}

#[test]
fn the_confidence_of_coarse_depth_is_passed_on_and_no_coarse_depth_means_zero() {
    let mut network = load("coarse_confidence").unwrap();
    let frame = plain([128; 3]);
    let coarse = coarse_with_a_hole();
    let with = network
        .estimate(view(&frame), &Pose3::identity(), Some(&coarse))
        .unwrap()
        .depth
        .get(0, 0)
        .unwrap();
    assert_close(with, depth_of(0.75, DEFAULT_DEPTH_RANGE_M));
    let without =
        network.estimate(view(&frame), &Pose3::identity(), None).unwrap().depth.get(0, 0).unwrap();
    assert_close(without, 20.0);
}

#[test]
fn nan_and_values_out_of_range_give_no_depth_and_are_counted() {
    for name in ["nan_at_full_red", "above_one_at_full_red"] {
        let mut network = load(name).unwrap();
        assert_eq!(
            network.estimate(view(&plain([255, 0, 0])), &Pose3::identity(), None),
            Err(NoDepth::NetworkOutput),
            "{name}"
        );
        assert_eq!(network.refused(), 1);
        assert!(
            network.estimate(view(&plain([100, 0, 0])), &Pose3::identity(), None).is_ok(),
            "{name}: a refused frame does not affect the next"
        );
        assert_eq!(network.refused(), 1);
    }
}

#[test]
fn an_image_or_coarse_depth_of_another_size_is_refused() {
    let mut network = load("coarse_six_channels").unwrap();
    let grey = vec![0; PIXELS];
    let wrong = [
        ImageView::rgb8(4, 8, &plain([0; 3]))
            .map(|frame| network.estimate(frame, &Pose3::identity(), None).cloned())
            .unwrap(),
        ImageView::new(8, 4, PixelFormat::Gray8, &grey)
            .map(|frame| network.estimate(frame, &Pose3::identity(), None).cloned())
            .unwrap(),
        network
            .estimate(view(&plain([0; 3])), &Pose3::identity(), Some(&DepthEstimate::none(4, 8)))
            .cloned(),
    ];
    assert!(wrong.iter().all(|result| *result == Err(NoDepth::FrameSize)));
    assert_eq!(network.refused(), 3);
}

fn refuse(bytes: &[u8]) -> NetworkError {
    DepthNetwork::load(&ONNX_RUNTIME, bytes, &camera(SIZE), NetworkOptions::default()).unwrap_err()
}

#[test]
fn bytes_that_are_no_model_are_refused_by_name() {
    for (bytes, word) in [
        (&b""[..], "empty"),
        (b"PK\x03\x04rest", "PyTorch"),
        (b"version https://git-lfs.github.com/spec/v1", "LFS"),
        (b"<!DOCTYPE html>", "HTML"),
    ] {
        let text = refuse(bytes).to_string();
        assert!(text.contains(word), "{text}");
    }
    assert!(matches!(refuse(&[0xa5; 1000]), NetworkError::Load { .. }));
}

#[test]
fn a_model_that_is_truncated_anywhere_is_refused_or_works() {
    let whole = model("weighted");
    for length in 0..whole.len() {
        let cut = DepthNetwork::load(
            &ONNX_RUNTIME,
            &whole[..length],
            &camera(SIZE),
            NetworkOptions::default(),
        );
        if let Ok(mut network) = cut {
            assert!(network.estimate(view(&plain([51; 3])), &Pose3::identity(), None).is_ok());
        }
    }
}

#[test]
fn unsuitable_models_are_refused_with_what_was_found_and_what_is_needed() {
    let cases: [(&str, &[&str]); 10] = [
        ("nan_always", &["grey image", "NaN"]),
        ("byte_input", &["`rgb` Tensor<u8>(1, 3, 4, 8)", "Tensor<f32>(1, 3, 4, 8)"]),
        ("three_inputs", &["3 tensors", "`c`", "[1, 6, height, width]"]),
        ("two_outputs", &["2 tensors", "`again`", "one output"]),
        ("no_batch", &["Tensor<f32>(3, 4, 8)", "(1, 3, 4, 8)"]),
        ("five_channels", &["(1, 5, 4, 8)", "(1, 3, 4, 8)"]),
        ("wide_output", &["output is `disparity`", "(1, 3, 4, 8)", "1 or 2"]),
        ("unnamed_output", &["`out`", "metadata"]),
        ("depth_range_upside_down", &["max_depth_m", "`1`", "above min_depth_m = 5"]),
        ("kind_unknown", &["kind = `stereo`", "`rgb`"]),
    ];
    for (name, words) in cases {
        let text = load(name).expect_err(name).to_string();
        for word in words {
            assert!(text.contains(word), "{name}: {text}");
        }
    }
}

#[test]
fn a_model_for_another_camera_is_refused_with_both_sizes() {
    let error = DepthNetwork::load(
        &ONNX_RUNTIME,
        &model("mean"),
        &camera((640, 192)),
        NetworkOptions::default(),
    )
    .unwrap_err();
    let text = error.to_string();
    assert!(text.contains("8x4") && text.contains("640x192"), "{text}");
}

/// The depth of `runs` runs of the model `deep` on this number of threads.
fn estimates(
    frame: ImageView<'_>,
    camera: &CameraModel,
    threads: usize,
    runs: usize,
) -> Vec<DepthEstimate> {
    let options = NetworkOptions { threads, ..NetworkOptions::default() };
    let mut network = DepthNetwork::load(&ONNX_RUNTIME, &model("deep"), camera, options).unwrap();
    (0..runs).map(|_| network.estimate(frame, &Pose3::identity(), None).unwrap().clone()).collect()
}

#[test]
fn depth_is_the_same_bit_for_bit_on_every_run_and_any_number_of_threads() {
    let width = 160;
    let height = 96;
    let bytes: Vec<u8> = (0..3 * width * height).map(|i| (i * 7919 / 13 % 256) as u8).collect();
    let frame = ImageView::rgb8(width, height, &bytes).unwrap();
    let camera = camera((width, height));
    let reference = estimates(frame, &camera, 1, 1).remove(0);
    assert!(
        reference.depth.values().windows(2).any(|pair| pair[0] != pair[1]),
        "a constant depth would not test anything"
    );
    for threads in [1, 2, 3, 7] {
        assert!(
            estimates(frame, &camera, threads, 3).iter().all(|estimate| *estimate == reference),
            "{threads} threads"
        );
    }
}

#[test]
fn the_digest_is_that_of_the_models_bytes() {
    let network = load("mean").unwrap();
    assert_eq!(network.digest(), blake3::hash(&model("mean")).to_hex().as_str());
    assert_ne!(network.digest(), load("metres").unwrap().digest());
}

#[test]
fn a_network_can_move_to_the_thread_that_runs_it() {
    fn assert_send<T: Send>() {}
    assert_send::<DepthNetwork>();
}

#[test]
fn sixteen_bit_inputs_and_outputs_give_the_same_depth_up_to_their_rounding() {
    let mut single = load("weighted").unwrap();
    let mut half = load("half").unwrap();
    let bytes: Vec<u8> = (0..3 * PIXELS).map(|i| (i * 37 % 256) as u8).collect();
    let [single, half] = [&mut single, &mut half]
        .map(|network| network.estimate(view(&bytes), &Pose3::identity(), None).unwrap().clone());
    for (single, half) in single.depth.values().iter().zip(half.depth.values()) {
        // 11 significant bits of x become this of a depth at most.
        assert!((single / half - 1.0).abs() < 2e-3, "{single} {half}");
    }
    assert_ne!(single, half, "the fixture must have 16 bits");
}

#[test]
fn coarse_depth_goes_through_a_sixteen_bit_input() {
    let coarse = coarse_with_a_hole();
    let mut network = load("half_six_channels").unwrap();
    let estimate =
        network.estimate(view(&plain([128; 3])), &Pose3::identity(), Some(&coarse)).unwrap();
    for (&found, &expected) in
        estimate.depth.values().iter().zip(coarse.depth.values()).filter(|&(_, &m)| m > 0.0)
    {
        assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    }
}

#[test]
fn the_cost_volume_differs_between_a_moved_and_a_still_image() {
    let size = (32, 16);
    let mut network = DepthNetwork::load(
        &ONNX_RUNTIME,
        &model("volume"),
        &camera(size),
        NetworkOptions::default(),
    )
    .unwrap();
    assert_eq!(network.spec().input, InputKind::RgbAndVolume { planes: 4, range_m: (0.5, 10.0) });
    let striped: Vec<u8> = (0..3 * size.0 * size.1)
        .map(|i| if i / 3 % size.0 / 8 % 2 == 0 { 10 } else { 250 })
        .collect();
    let frame = ImageView::rgb8(size.0, size.1, &striped).unwrap();
    let [first_m, second_m] = [0.0, 0.15].map(|x_m| {
        let estimate = network.estimate(frame, &Pose3::translation(x_m, 0.0, 0.0), None).unwrap();
        estimate.depth.values().iter().copied().fold(f32::INFINITY, f32::min)
    });
    // Without an earlier frame there is no cost: the far end of the network's range.
    assert_close(first_m, 20.0);
    // The same image from another position has a high cost at 0.5 m.
    assert!(second_m < 1.0);
}

#[test]
fn a_pose_that_is_not_finite_is_refused_where_it_is_needed() {
    let size = (32, 16);
    let mut network = DepthNetwork::load(
        &ONNX_RUNTIME,
        &model("volume"),
        &camera(size),
        NetworkOptions::default(),
    )
    .unwrap();
    let bytes = vec![0; 3 * size.0 * size.1];
    let frame = ImageView::rgb8(size.0, size.1, &bytes).unwrap();
    let nowhere = Pose3::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(network.estimate(frame, &nowhere, None), Err(NoDepth::PoseNotFinite));
    assert!(load("mean").unwrap().estimate(view(&plain([9; 3])), &nowhere, None).is_ok());
}

#[test]
fn an_unavailable_provider_is_an_error_that_names_the_available_ones() {
    let refused = [Provider::Xnnpack, Provider::Cuda, Provider::TensorRt].into_iter().filter_map(
        |provider| {
            let options = NetworkOptions { provider, ..NetworkOptions::default() };
            let loaded = DepthNetwork::load(&ONNX_RUNTIME, &model("mean"), &camera(SIZE), options);
            Some((provider, loaded.err()?.to_string()))
        },
    );
    for (provider, text) in refused {
        // A library with GPU support on a computer without a GPU fails one step later.
        let explained = text.contains("it has: cpu") || text.contains("does not start");
        assert!(explained && text.contains(provider.name()), "{text}");
    }
}

/// A model with one more entry of metadata, which is field 14 of ONNX's `ModelProto`. Protocol buffers may be concatenated.
fn with_metadata(model: &[u8], key: &str, value: &str) -> Vec<u8> {
    let text =
        |field: u8, text: &str| [&[field << 3 | 2, text.len() as u8], text.as_bytes()].concat();
    let entry = [text(1, key), text(2, value)].concat();
    [model, &[14 << 3 | 2, entry.len() as u8], &entry].concat()
}

/// The model is certain everywhere, and the robot stands, so that no motion has confirmed anything.
#[test]
fn a_robot_joins_a_network_with_dense_depth_maps_that_with_caution_and_compares_it_alone() {
    let mut robots = ["coarse", "dense"].map(|given| {
        let config = RobotConfig { depth_source: DepthSource::Network, ..test_robot::config() };
        let model = with_metadata(&model("any_size"), "given_depth", given);
        let options = NetworkOptions::default();
        let network = DepthNetwork::load(&ONNX_RUNTIME, &model, &config.camera, options).unwrap();
        let mut robot = Robot::new(config, Some(network)).unwrap();
        for tick in 0..3 {
            let mut input = test_robot::standing(tick, &Pose2::IDENTITY, Pose2::IDENTITY);
            // Without texture there would be no dense depth. The model says 1 to 5 m for these colours, and the walls are 2 m away.
            let noise = |at: u32| (at.wrapping_mul(2_654_435_761) >> 24) as u8 % 16 + 4;
            let rgb = (0..64 * 32 * 3).map(noise);
            input.frame = Some(RgbImage { width: 64, height: 32, rgb: rgb.collect() });
            recompute(&mut robot, &input).unwrap();
        }
        robot
    });
    let [coarse, dense] = &mut robots;
    let confidence = |depth: Option<&DepthEstimate>| depth.unwrap().confidence.clone();
    // A network that is given coarse depth stays as it is.
    assert!(confidence(coarse.network_depth()).iter().all(|p| *p == 1.0));
    assert_eq!(coarse.mapped_depth(), coarse.network_depth());
    // Its own depth and dense depth agree somewhere, and there, dense depth is not certain.
    assert!(dense.dense_depth().is_some());
    let joined = confidence(dense.network_depth());
    assert!(joined.iter().any(|p| *p < 1.0) && joined.iter().any(|p| *p > 0.75), "{joined:?}");
    let own = dense.compared_depth().unwrap();
    assert!(own.confidence.iter().all(|p| *p == 0.75));
    assert_eq!(own.depth, coarse.compared_depth().unwrap().depth);
    let mapped = confidence(dense.mapped_depth());
    assert!(mapped.iter().zip(&joined).all(|(mapped, joined)| *mapped == joined.min(0.75)));
}
