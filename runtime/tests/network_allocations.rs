//! How often a network asks the allocator for memory, call by call, once it is loaded.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot set up its scene has failed"
)]

use std::path::{Path, PathBuf};

use hal::{CameraModel, ImageView, Pose3};
use ort::environment::Environment;
use runtime::perception::{DepthEstimate, DepthNetwork, NetworkOptions};

/// What ort 2.0.0-rc.15 allocates in `Session::run_binding` for the output that it hands back; its safe interface has no call
/// that allocates less. ONNX Runtime itself (C++) has an allocator of its own, which is not counted.
const OF_ORT: u64 = 2;

fn onnx_runtime() -> Environment {
    let library = std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from).or_else(installed);
    let library = library.expect("no ONNX Runtime: run `cargo xtask setup`, or set ORT_DYLIB_PATH");
    ort::init_from(library)
        .expect("ONNX Runtime does not load")
        .with_telemetry(false)
        .build()
        .unwrap()
}

fn installed() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/onnxruntime");
    let mut files = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    files.find(|path| path.to_string_lossy().contains("libonnxruntime.so"))
}

fn model(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/models/{name}.onnx")))
        .unwrap()
}

/// Allocations of one call, after some that do not count.
fn per_call(mut call: impl FnMut()) -> u64 {
    (0..20).for_each(|_| call());
    let counted = allocation_counter::measure(|| (0..100).for_each(|_| call()));
    assert_eq!(counted.count_total % 100, 0, "every call is like every other");
    assert_eq!(counted.count_current, 0, "nothing stays");
    counted.count_total / 100
}

/// One test: a process has one ONNX Runtime.
#[test]
fn a_call_allocates_nothing_but_what_ort_needs_for_its_answer() {
    let environment = onnx_runtime();
    let options = NetworkOptions::default();
    for (name, (width, height)) in [
        ("mean", (8, 4)),
        ("half", (8, 4)),
        ("coarse_second_input", (8, 4)),
        ("half_six_channels", (8, 4)),
        ("volume", (32, 16)),
    ] {
        let camera = CameraModel::pinhole(width, height, 1.5);
        let mut network = DepthNetwork::load(&environment, &model(name), &camera, options).unwrap();
        let bytes: Vec<u8> = (0..3 * width * height).map(|i| (i * 37 % 256) as u8).collect();
        let coarse = DepthEstimate::none(width, height);
        let mut x_m = 0.0;
        let allocations = per_call(|| {
            // Far enough for a new keyframe every other call.
            x_m += 0.04;
            let frame = ImageView::rgb8(width, height, &bytes).unwrap();
            network.estimate(frame, &Pose3::translation(x_m, 0.0, 0.0), Some(&coarse)).unwrap();
        });
        assert_eq!(allocations, OF_ORT, "{name}");
    }
}
