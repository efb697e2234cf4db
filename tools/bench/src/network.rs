//! What networks cost through the runtime, and what ONNX Runtime costs without us.

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use anyhow::Context;
use hal::{CameraModel, ImageView, Pose3};
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::Tensor;
use runtime::perception::{DepthNetwork, FlowNetwork, NetworkOptions};

use crate::report::{Row, time, time_against};

/// The mean of red, green and blue: as good as no inference.
const EMPTY: &[u8] = include_bytes!("../../../runtime/tests/models/any_size.onnx");
/// Hands one plane of the volume on: as good as no inference.
const VOLUME: &[u8] = include_bytes!("../../../runtime/tests/models/volume_64_any_size.onnx");
/// The network that the robot ships with.
const DEFAULT: &[u8] = include_bytes!("../../../firmware-host/models/default.onnx");
const DEFAULT_TURNS: usize = 101;
const SIZE: (usize, usize) = (640, 192);
/// Real networks as `cargo xtask models` exports them, with the turns that they are worth.
const REAL: [(&str, usize); 4] =
    [("monodepth2_r18", 20), ("edn_r18", 20), ("raft_small_12", 7), ("raft_large_12", 5)];

/// Measures the room. Without ONNX Runtime (`ORT_DYLIB_PATH`) it has no rows; real networks are those in the folder that
/// `BENCH_MODELS` names.
///
/// # Errors
/// When ONNX Runtime or a model does not load.
pub fn rows() -> anyhow::Result<Vec<Row>> {
    let Some(library) = std::env::var_os("ORT_DYLIB_PATH") else { return Ok(Vec::new()) };
    let onnx_runtime = ort::init_from(library)?.with_telemetry(false).build()?;
    let image =
        |step: usize| (0..3 * SIZE.0 * SIZE.1).map(|i| (i * step % 256) as u8).collect::<Vec<_>>();
    let images = [image(31), image(37)];
    let mut rows = vec![empty(&onnx_runtime, &images[0])?, volume(&onnx_runtime, &images)?];
    for threads in [1, 2] {
        let row = real(&onnx_runtime, "default network", DEFAULT, threads, DEFAULT_TURNS, &images)?;
        rows.push(row.goal(0.006, 0.004));
    }
    if let Some(folder) = std::env::var_os("BENCH_MODELS") {
        for (name, turns) in REAL {
            let file = Path::new(&folder).join(name).with_extension("onnx");
            if !file.is_file() {
                continue;
            }
            let model =
                std::fs::read(&file).with_context(|| format!("reading {}", file.display()))?;
            for threads in [1, 2] {
                rows.push(real(&onnx_runtime, name, &model, threads, turns, &images)?);
            }
        }
    }
    Ok(rows)
}

/// What surrounds inference: planes in, depth out.
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
    Ok(Row::seconds("network", "picture to depth around an empty network, 640x192", ours)
        .peer("ort run()", peer.median)
        .note("the peer neither sorts the channels nor makes and checks depth"))
}

/// The cost volume of a robot that drives forward.
fn volume(onnx_runtime: &Environment, images: &[Vec<u8>; 2]) -> anyhow::Result<Row> {
    let mut network =
        DepthNetwork::load(onnx_runtime, VOLUME, &camera(), NetworkOptions::default())?;
    let frame = view(&images[0])?;
    let mut way_m = 0.0;
    let mut step = || {
        way_m += 0.03;
        network.estimate(frame, &Pose3::translation(0.0, 0.0, way_m), None).is_ok()
    };
    // Until there are two frames to compare with.
    (0..20).for_each(|_| _ = step());
    Ok(Row::seconds(
        "network",
        "cost volume, 64 planes of 160x48, 2 references, 1 thread",
        time(50, step),
    ))
}

/// A real network on `threads` threads, through us and with nothing but ort.
fn real(
    onnx_runtime: &Environment,
    name: &str,
    model: &[u8],
    threads: usize,
    turns: usize,
    images: &[Vec<u8>; 2],
) -> anyhow::Result<Row> {
    let options = NetworkOptions { threads, ..NetworkOptions::default() };
    let mut session = bare_session(onnx_runtime, model, threads)?;
    let inputs: Vec<&[u8]> =
        images.iter().take(session.inputs().len()).map(Vec::as_slice).collect();
    let [first, second] = [view(&images[0])?, view(&images[1])?];
    let peer = || bare_run(&mut session, &inputs);
    let (ours, peer) = if name.starts_with("raft") {
        let mut network = FlowNetwork::load(onnx_runtime, model, SIZE, options)?;
        time_against(turns, || network.estimate(first, second).is_ok(), peer)
    } else {
        let mut network = DepthNetwork::load(onnx_runtime, model, &camera(), options)?;
        time_against(turns, || network.estimate(first, &Pose3::identity(), None).is_ok(), peer)
    };
    let plural = if threads == 1 { "" } else { "s" };
    Ok(Row::seconds("network", format!("{name}, 640x192, {threads} thread{plural}"), ours)
        .peer("ort run()", peer.median)
        .note("waiting threads spin during a run, in both"))
}

fn bare_session(onnx_runtime: &Environment, model: &[u8], threads: usize) -> ort::Result<Session> {
    // Spinning on after its run, as by default, it would take the other's cores in turn.
    let builder = Session::builder(onnx_runtime)?.with_intra_threads(threads)?;
    builder.with_config_entry("session.force_spinning_stop", "1")?.commit_from_memory(model)
}

/// What one writes without us: new tensors for every call.
fn bare_run(session: &mut Session, images: &[&[u8]]) -> ort::Result<usize> {
    let tensor = |image: &&[u8]| -> ort::Result<SessionInputValue<'static>> {
        let planes: Vec<f32> = image.iter().map(|&byte| f32::from(byte) / 255.0).collect();
        Ok(Tensor::from_array(([1, 3, SIZE.1, SIZE.0], planes))?.into())
    };
    let inputs = images.iter().map(tensor).collect::<ort::Result<Vec<_>>>()?;
    session.run(inputs.as_slice()).map(|outputs| outputs.len())
}

fn camera() -> CameraModel {
    CameraModel::pinhole(SIZE.0, SIZE.1, FRAC_PI_2)
}

fn view(image: &[u8]) -> anyhow::Result<ImageView<'_>> {
    Ok(ImageView::rgb8(SIZE.0, SIZE.1, image)?)
}
