//! Inference of depth networks through the runtime, and with ort alone.

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use anyhow::Context;
use hal::{CameraModel, ImageView, Pose3};
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::Tensor;
use runtime::perception::{DepthNetwork, NetworkOptions};

use crate::report::{Row, time, time_against};

/// The mean of red, green and blue: inference takes almost no time.
const EMPTY: &[u8] = include_bytes!("../../../runtime/tests/models/any_size.onnx");
/// Copies one plane of the cost volume: inference takes almost no time.
const VOLUME: &[u8] = include_bytes!("../../../runtime/tests/models/volume_64_any_size.onnx");
/// The network that the robot ships with.
const DEFAULT: &[u8] = include_bytes!("../../../firmware-host/models/default.onnx");
const DEFAULT_RUNS: usize = 101;
const SIZE: (usize, usize) = (640, 192);
/// Depth networks that `cargo xtask models` exports, with their number of runs.
const REAL: [(&str, usize); 2] = [("monodepth2_r18", 20), ("edn_r18", 20)];

/// Measures all rows of this module. Without ONNX Runtime (`ORT_DYLIB_PATH`) there are none. Exported networks are read from
/// the folder in `BENCH_MODELS`.
///
/// # Errors
/// When ONNX Runtime or a model does not load.
pub fn rows() -> anyhow::Result<Vec<Row>> {
    let Some(library) = std::env::var_os("ORT_DYLIB_PATH") else { return Ok(Vec::new()) };
    let onnx_runtime = ort::init_from(library)?.with_telemetry(false).build()?;
    let images: [Vec<u8>; 2] =
        [31, 37].map(|step| (0..3 * SIZE.0 * SIZE.1).map(|i| (i * step % 256) as u8).collect());
    let mut rows = vec![empty(&onnx_runtime, &images[0])?, volume(&onnx_runtime, &images)?];
    for threads in [1, 2] {
        let row = real(&onnx_runtime, "default network", DEFAULT, threads, DEFAULT_RUNS, &images)?;
        rows.push(row.goal(0.006, 0.004));
    }
    if let Some(folder) = std::env::var_os("BENCH_MODELS") {
        for (name, runs) in REAL {
            let file = Path::new(&folder).join(name).with_extension("onnx");
            if !file.is_file() {
                continue;
            }
            let model =
                std::fs::read(&file).with_context(|| format!("reading {}", file.display()))?;
            for threads in [1, 2] {
                rows.push(real(&onnx_runtime, name, &model, threads, runs, &images)?);
            }
        }
    }
    Ok(rows)
}

/// The overhead of the runtime around inference.
fn empty(onnx_runtime: &Environment, image: &[u8]) -> anyhow::Result<Row> {
    let mut network =
        DepthNetwork::load(onnx_runtime, EMPTY, &camera(), NetworkOptions::default())?;
    let mut session = bare_session(onnx_runtime, EMPTY, 1)?;
    let frame = view(image)?;
    let (ours, peer) = time_against(
        200,
        || network.estimate(frame, &Pose3::identity(), None).is_ok(),
        || bare_run(&mut session, &[image]),
    );
    Ok(Row::seconds("network", "frame to depth around an empty network, 640x192", ours)
        .peer("ort run()", peer.median)
        .note("the peer neither splits the channels nor computes and checks depth"))
}

/// The cost volume of a robot that drives forward.
fn volume(onnx_runtime: &Environment, images: &[Vec<u8>; 2]) -> anyhow::Result<Row> {
    let mut network =
        DepthNetwork::load(onnx_runtime, VOLUME, &camera(), NetworkOptions::default())?;
    let frame = view(&images[0])?;
    let mut distance_m = 0.0;
    let mut step = || {
        distance_m += 0.03;
        network.estimate(frame, &Pose3::translation(0.0, 0.0, distance_m), None).is_ok()
    };
    // These runs are a warm-up, until there are two frames to compare with.
    (0..20).for_each(|_| _ = step());
    Ok(Row::seconds(
        "network",
        "cost volume, 64 planes of 160x48, 2 references, 1 thread",
        time(50, step),
    ))
}

/// A network on `threads` threads, through the runtime and with ort alone.
fn real(
    onnx_runtime: &Environment,
    name: &str,
    model: &[u8],
    threads: usize,
    runs: usize,
    images: &[Vec<u8>; 2],
) -> anyhow::Result<Row> {
    let options = NetworkOptions { threads, ..NetworkOptions::default() };
    let mut session = bare_session(onnx_runtime, model, threads)?;
    let mut network = DepthNetwork::load(onnx_runtime, model, &camera(), options)?;
    let inputs: Vec<&[u8]> =
        images.iter().take(session.inputs().len()).map(Vec::as_slice).collect();
    let frame = view(&images[0])?;
    let (ours, peer) = time_against(
        runs,
        || network.estimate(frame, &Pose3::identity(), None).is_ok(),
        || bare_run(&mut session, &inputs),
    );
    let plural = if threads == 1 { "" } else { "s" };
    Ok(Row::seconds("network", format!("{name}, 640x192, {threads} thread{plural}"), ours)
        .peer("ort run()", peer.median)
        .note("threads spin while they wait for the next layer, in both"))
}

fn bare_session(onnx_runtime: &Environment, model: &[u8], threads: usize) -> ort::Result<Session> {
    // By default its threads would continue to spin after a run, and slow down the other's next run.
    let builder = Session::builder(onnx_runtime)?.with_intra_threads(threads)?;
    builder.with_config_entry("session.force_spinning_stop", "1")?.commit_from_memory(model)
}

/// Inference with ort alone: new tensors for every call.
fn bare_run(session: &mut Session, images: &[&[u8]]) -> ort::Result<usize> {
    let inputs = images.iter().map(|image| tensor(image)).collect::<ort::Result<Vec<_>>>()?;
    session.run(inputs.as_slice()).map(|outputs| outputs.len())
}

fn tensor(image: &[u8]) -> ort::Result<SessionInputValue<'static>> {
    let planes: Vec<f32> = image.iter().map(|&byte| f32::from(byte) / 255.0).collect();
    Ok(Tensor::from_array(([1, 3, SIZE.1, SIZE.0], planes))?.into())
}

fn camera() -> CameraModel {
    CameraModel::pinhole(SIZE.0, SIZE.1, FRAC_PI_2)
}

fn view(image: &[u8]) -> anyhow::Result<ImageView<'_>> {
    Ok(ImageView::rgb8(SIZE.0, SIZE.1, image)?)
}
