//! Optical flow from a network: any ONNX model that takes two pictures and gives where the first one's pixels are in the second.

use hal::{ImageView, PixelFormat};
use ort::environment::Environment;

use super::bound::{BoundSession, Model, Port, TensorInfo};
use super::options::NetworkOptions;
use super::spec::{check_stated_size, check_tensor, list};
use super::{NetworkError, planes};
use crate::perception::NoDepth;
use crate::perception::flow::FlowField;

const TWO_PICTURES: &str = "two pictures, each [1, 3, height, width]";
const ONE_FLOW: &str =
    "one flow field [1, 2, height, width] in pixels; export only the last iteration";

/// Everything that must be known about a flow model to run it.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowSpec {
    /// Black and white as the model wants them (metadata `input_range`: `0..1`, `-1..1` or `0..255`; without it, `0..1`).
    pub input_range: (f32, f32),
    /// Columns and rows of the pictures and of the flow.
    pub size: (usize, usize),
    /// What the model calls itself (metadata `version`).
    pub version: Option<String>,
    /// The picture that the flow starts from, then the one that it leads to: in the model's order, unless the metadata
    /// `from` names the first.
    input_ports: [Port; 2],
    output_port: Port,
}

impl FlowSpec {
    fn read(
        inputs: &[TensorInfo],
        outputs: &[TensorInfo],
        metadata: impl Fn(&str) -> Option<String>,
        size: (usize, usize),
    ) -> Result<Self, NetworkError> {
        let [first, second] = inputs else {
            return Err(NetworkError::Inputs { found: list(inputs), needed: TWO_PICTURES });
        };
        let [flow] = outputs else {
            return Err(NetworkError::Outputs { found: list(outputs), needed: ONE_FLOW });
        };
        let mut input_ports =
            [check_tensor("input", first, &[3], size)?, check_tensor("input", second, &[3], size)?];
        let output_port = check_tensor("output", flow, &[2], size)?;
        match metadata("kind") {
            Some(value) if value != "flow" => {
                let allowed = "`flow`, which is what its inputs and output show".to_owned();
                return Err(NetworkError::Metadata { key: "kind", value, allowed });
            }
            _ => check_stated_size(&metadata, size)?,
        }
        if let Some(from) = metadata("from") {
            match input_ports.iter().position(|port| port.name == from) {
                Some(place) => input_ports.rotate_left(place),
                None => {
                    let allowed = format!("`{}`, `{}`", first.name, second.name);
                    return Err(NetworkError::Metadata { key: "from", value: from, allowed });
                }
            }
        }
        let input_range = input_range(&metadata)?;
        Ok(Self { input_range, size, version: metadata("version"), input_ports, output_port })
    }
}

fn input_range(metadata: &impl Fn(&str) -> Option<String>) -> Result<(f32, f32), NetworkError> {
    match metadata("input_range").as_deref() {
        None | Some("0..1") => Ok((0.0, 1.0)),
        Some("-1..1") => Ok((-1.0, 1.0)),
        Some("0..255") => Ok((0.0, 255.0)),
        Some(value) => {
            let allowed = "`0..1`, `-1..1`, `0..255`".to_owned();
            Err(NetworkError::Metadata { key: "input_range", value: value.to_owned(), allowed })
        }
    }
}

/// A loaded flow model with its bound memory. One call of [`estimate`](Self::estimate) blocks for one inference.
#[derive(Debug)]
pub struct FlowNetwork {
    spec: FlowSpec,
    digest: String,
    session: BoundSession,
    flow: FlowField,
}

impl FlowNetwork {
    /// Loads a model from the bytes of its file, for pictures of `size` (columns, rows), and tries it once.
    ///
    /// # Errors
    /// Whatever keeps the model from being a flow network for such pictures; see [`NetworkError`].
    pub fn load(
        onnx_runtime: &Environment,
        model: &[u8],
        size: (usize, usize),
        options: NetworkOptions,
    ) -> Result<Self, NetworkError> {
        let loaded = Model::load(onnx_runtime, model, options)?;
        let spec = FlowSpec::read(&loaded.inputs, &loaded.outputs, loaded.metadata()?, size)?;
        let session = loaded.bind(&spec.input_ports, &spec.output_port)?;
        let digest = blake3::hash(model).to_hex().to_string();
        let no_flow = vec![[0.0; 2]; size.0 * size.1];
        let flow = FlowField::from_vec(size.0, size.1, no_flow).ok_or_else(|| {
            NetworkError::WarmUp { reason: "the picture is too large".to_owned() }
        })?;
        let mut network = Self { spec, digest, session, flow };
        network.warm_up()?;
        Ok(network)
    }

    fn warm_up(&mut self) -> Result<(), NetworkError> {
        let (low, high) = self.spec.input_range;
        for input in 0..2 {
            self.session.write(input, |planes| planes.fill(0.5 * (low + high)));
        }
        match self.run() {
            Ok(true) => Ok(()),
            Ok(false) => {
                Err(NetworkError::WarmUp { reason: "its flow is NaN or infinite".to_owned() })
            }
            Err(error) => Err(NetworkError::WarmUp { reason: error.to_string() }),
        }
    }

    /// Where the pixels of `from` are in `to`, both RGB8. A pixel whose match would lie farther away than the picture is large has
    /// none (NaN).
    ///
    /// # Errors
    /// [`NoDepth::FrameSize`] for another size or format; [`NoDepth::NetworkOutput`] when the model fails or its flow holds NaN
    /// or infinity.
    pub fn estimate(
        &mut self,
        from: ImageView<'_>,
        to: ImageView<'_>,
    ) -> Result<&FlowField, NoDepth> {
        for (input, frame) in [from, to].into_iter().enumerate() {
            if frame.format() != PixelFormat::Rgb8
                || (frame.width(), frame.height()) != self.spec.size
            {
                return Err(NoDepth::FrameSize);
            }
            let range = self.spec.input_range;
            self.session.write(input, |planes| planes::write_rgb(frame.data(), range, planes));
        }
        match self.run() {
            Ok(true) => Ok(&self.flow),
            Ok(false) => Err(NoDepth::NetworkOutput),
            Err(error) => {
                tracing::error!(%error, "the flow network failed");
                Err(NoDepth::NetworkOutput)
            }
        }
    }

    /// One inference over the bound memory. `false`: its output is worthless.
    fn run(&mut self) -> ort::Result<bool> {
        let Self { spec, session, flow, .. } = self;
        session.run(|output| read_flow(output, spec.size, flow.values_mut()))
    }

    /// What the model takes and gives.
    #[must_use]
    pub fn spec(&self) -> &FlowSpec {
        &self.spec
    }

    /// BLAKE3 digest of the model's bytes, in hex.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }
}

/// Planes of x and y into pairs. `false` when a number is not finite.
fn read_flow(output: &[f32], (width, height): (usize, usize), flow: &mut [[f32; 2]]) -> bool {
    let Some((xs, ys)) = output.split_at_checked(flow.len()) else { return false };
    let (farthest_x, farthest_y) = (width as f32, height as f32);
    let mut sound = xs.len() == ys.len();
    for ((flow, &x), &y) in flow.iter_mut().zip(xs).zip(ys) {
        sound &= x.is_finite() && y.is_finite();
        let inside = x.abs() <= farthest_x && y.abs() <= farthest_y;
        *flow = if inside { [x, y] } else { [f32::NAN; 2] };
    }
    sound
}
