//! What the depth network costs around its inference, and what ONNX Runtime costs without us.

use hal::{CameraModel, ImageView, Pose3};
use ort::environment::Environment;
use ort::session::Session;
use ort::value::Tensor;
use runtime::perception::{DepthNetwork, NetworkOptions};

use crate::report::{Row, time_against};

/// The mean of red, green and blue: as good as no inference.
const MODEL: &[u8] = include_bytes!("../../../runtime/tests/models/any_size.onnx");
const SIZE: (usize, usize) = (640, 192);

/// Measures the room. Without ONNX Runtime (`ORT_DYLIB_PATH`) it has no rows.
///
/// # Errors
/// When ONNX Runtime or the model does not load.
pub fn rows() -> anyhow::Result<Vec<Row>> {
    let Some(library) = std::env::var_os("ORT_DYLIB_PATH") else { return Ok(Vec::new()) };
    let onnx_runtime = ort::init_from(library)?.with_telemetry(false).build()?;
    let camera = CameraModel::pinhole(SIZE.0, SIZE.1, std::f64::consts::FRAC_PI_2);
    let mut network = DepthNetwork::load(&onnx_runtime, MODEL, &camera, NetworkOptions::default())?;
    let mut session = bare_session(&onnx_runtime)?;
    let picture: Vec<u8> = (0..3 * SIZE.0 * SIZE.1).map(|i| (i * 31 % 256) as u8).collect();
    let frame = ImageView::rgb8(SIZE.0, SIZE.1, &picture)?;
    let (ours, peer) = time_against(
        200,
        || network.estimate(frame, &Pose3::identity(), None).is_ok(),
        || {
            let planes: Vec<f32> = picture.iter().map(|&byte| f32::from(byte) / 255.0).collect();
            let input = Tensor::from_array(([1, 3, SIZE.1, SIZE.0], planes))?;
            session.run(ort::inputs![input]).map(|outputs| outputs.len())
        },
    );
    let row = Row::seconds("network", "picture to depth around an empty network, 640x192", ours)
        .peer("ort run()", peer.median)
        .note("the peer neither sorts the channels nor makes and checks depth");
    Ok(vec![row])
}

fn bare_session(onnx_runtime: &Environment) -> ort::Result<Session> {
    Session::builder(onnx_runtime)?.with_intra_threads(1)?.commit_from_memory(MODEL)
}
