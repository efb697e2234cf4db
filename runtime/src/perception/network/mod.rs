//! The depth network: an ONNX model run by ONNX Runtime.
//!
//! The model says what it takes and gives in its shapes and its metadata: `kind` (`rgb` or `rgb+coarse`), `output` (`depth`
//! or `disparity`), `min_depth_m`, `max_depth_m`, `input_width`, `input_height`, `version`. All of it is optional and all of
//! it is checked when the model is loaded, together with one run on a grey picture.
//!
//! The same picture gives the same depth, bit for bit, on any number of threads.

mod error;
mod planes;
mod spec;
#[cfg(test)]
mod tests;

pub use error::NetworkError;
pub use spec::{DEFAULT_DEPTH_RANGE_M, InputKind, ModelSpec, OutputKind};

use hal::{ImageView, PixelFormat};
use ort::environment::Environment;
use ort::memory::Allocator;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use ort::session::{IoBinding, Session};
use ort::value::{Outlet, Tensor, TensorElementType};

use super::{DepthEstimate, NoDepth};
use spec::TensorInfo;

/// How a model is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetworkOptions {
    /// Threads of one inference, at least 1. They never spin: a waiting thread would steal the time of the control loop.
    pub threads: usize,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self { threads: 1 }
    }
}

/// A loaded model with its bound memory. One call of [`estimate`](Self::estimate) blocks for one inference.
#[derive(Debug)]
pub struct DepthNetwork {
    spec: ModelSpec,
    digest: String,
    session: Session,
    binding: IoBinding,
    /// Bound input with the picture; joined models find the coarse planes behind it.
    picture: Tensor<f32>,
    /// Bound input with the coarse planes, for models that take them apart.
    coarse: Option<Tensor<f32>>,
    estimate: DepthEstimate,
    refused: u64,
}

impl DepthNetwork {
    /// Loads a model from the bytes of its file, for pictures of `camera_size` (columns, rows), and tries it once.
    ///
    /// # Errors
    /// Whatever keeps the model from being this robot's depth network; see [`NetworkError`].
    pub fn load(
        onnx_runtime: &Environment,
        model: &[u8],
        camera_size: (usize, usize),
        options: NetworkOptions,
    ) -> Result<Self, NetworkError> {
        if let Some(found) = error::other_kind(model) {
            return Err(NetworkError::NotOnnx { found });
        }
        let mut builder = session_builder(onnx_runtime, options)
            .map_err(|error| NetworkError::Options { threads: options.threads, reason: error.to_string() })?;
        let session = builder.commit_from_memory(model).map_err(load_error)?;
        let spec = read_spec(&session, camera_size)?;
        let digest = blake3::hash(model).to_hex().to_string();
        let mut network = Self::bind(session, spec, digest).map_err(load_error)?;
        network.warm_up()?;
        Ok(network)
    }

    /// Gives inputs and output memory of their own that stays bound, so that a call copies nothing and allocates nothing here.
    /// Only owned tensors are bound: binding a borrowed one deadlocks in ort 2.0.0-rc.15.
    fn bind(session: Session, spec: ModelSpec, digest: String) -> ort::Result<Self> {
        let (width, height) = spec.size;
        let mut binding = session.create_binding()?;
        let planes = |channels: usize| {
            Tensor::from_array(([1, channels, height, width], vec![0.0_f32; channels * height * width]))
        };
        let picture = planes(spec.picture_channels())?;
        binding.bind_input(spec.input_names.0.as_str(), &picture)?;
        let coarse = match &spec.input_names.1 {
            Some(name) => {
                let coarse = planes(3)?;
                binding.bind_input(name.as_str(), &coarse)?;
                Some(coarse)
            }
            None => None,
        };
        let output = Tensor::<f32>::new(&Allocator::default(), [1, spec.output_channels(), height, width])?;
        binding.bind_output(spec.output_name.as_str(), output)?;
        let estimate = DepthEstimate::none(width, height);
        Ok(Self { spec, digest, session, binding, picture, coarse, estimate, refused: 0 })
    }

    /// The first run allocates inside ONNX Runtime, and shows whether the model computes anything at all.
    fn warm_up(&mut self) -> Result<(), NetworkError> {
        self.picture.extract_tensor_mut().1.fill(0.5);
        self.write_coarse(None);
        let outcome = self.run();
        self.estimate.clear();
        match outcome {
            Ok(true) => Ok(()),
            Ok(false) => {
                let (min, max) = self.spec.depth_range_m;
                let reason = match self.spec.output {
                    OutputKind::Depth => format!("its depth is NaN or outside {min} to {max} m"),
                    OutputKind::Disparity => "its disparity is NaN or outside 0 to 1".to_owned(),
                };
                Err(NetworkError::WarmUp { reason })
            }
            Err(error) => Err(NetworkError::WarmUp { reason: error.to_string() }),
        }
    }

    /// Depth of one RGB8 picture of the camera's size. Models that take coarse depth are told "none" where `coarse` is `None`;
    /// the others ignore it.
    ///
    /// # Errors
    /// [`NoDepth::FrameSize`] for another size or format; [`NoDepth::NetworkOutput`] when the model fails, says NaN, or
    /// leaves the range that it promises. Both are counted by [`refused`](Self::refused).
    pub fn estimate(
        &mut self,
        frame: ImageView<'_>,
        coarse: Option<&DepthEstimate>,
    ) -> Result<&DepthEstimate, NoDepth> {
        match self.try_estimate(frame, coarse) {
            Ok(()) => Ok(&self.estimate),
            Err(why) => {
                self.refused += 1;
                self.estimate.clear();
                Err(why)
            }
        }
    }

    fn try_estimate(&mut self, frame: ImageView<'_>, coarse: Option<&DepthEstimate>) -> Result<(), NoDepth> {
        let size = self.spec.size;
        let fits = |coarse: &DepthEstimate| (coarse.depth.width(), coarse.depth.height()) == size;
        if frame.format() != PixelFormat::Rgb8 || (frame.width(), frame.height()) != size || !coarse.is_none_or(fits) {
            return Err(NoDepth::FrameSize);
        }
        planes::write_rgb(frame.data(), self.picture.extract_tensor_mut().1);
        self.write_coarse(coarse);
        match self.run() {
            Ok(true) => Ok(()),
            Ok(false) => Err(NoDepth::NetworkOutput),
            Err(error) => {
                tracing::error!(%error, "the depth network failed");
                Err(NoDepth::NetworkOutput)
            }
        }
    }

    /// Into the input of its own, or behind the picture, or nowhere.
    fn write_coarse(&mut self, coarse: Option<&DepthEstimate>) {
        let pixels = self.spec.size.0 * self.spec.size.1;
        let planes = match (self.spec.input, &mut self.coarse) {
            (InputKind::Rgb, _) => return,
            (_, Some(tensor)) => tensor.extract_tensor_mut().1,
            (_, None) => &mut self.picture.extract_tensor_mut().1[3 * pixels..],
        };
        planes::write_coarse(coarse, self.spec.depth_range_m, planes);
    }

    /// One inference over the bound memory. `false`: its output is worthless.
    fn run(&mut self) -> ort::Result<bool> {
        let outputs = self.session.run_binding(&self.binding)?;
        let (_, output) = outputs[0].try_extract_tensor::<f32>()?;
        Ok(planes::read_output(output, &self.spec, &mut self.estimate))
    }

    /// What the last successful [`estimate`](Self::estimate) returned; no depth after one that failed.
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    /// What the model takes and gives.
    #[must_use]
    pub fn spec(&self) -> &ModelSpec {
        &self.spec
    }

    /// BLAKE3 digest of the model's bytes, in hex.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// How many pictures got no depth.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

fn load_error(error: impl std::fmt::Display) -> NetworkError {
    NetworkError::Load { reason: error.to_string() }
}

fn session_builder(onnx_runtime: &Environment, options: NetworkOptions) -> ort::Result<SessionBuilder> {
    // One after the other, on exactly these threads, which sleep while they wait.
    Ok(SessionBuilder::new(onnx_runtime)?
        .with_intra_threads(options.threads.max(1))?
        .with_parallel_execution(false)?
        .with_intra_op_spinning(false)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_deterministic_compute(true)?)
}

fn read_spec(session: &Session, camera_size: (usize, usize)) -> Result<ModelSpec, NetworkError> {
    let inputs: Vec<_> = session.inputs().iter().map(tensor_info).collect();
    let outputs: Vec<_> = session.outputs().iter().map(tensor_info).collect();
    let metadata = session.metadata().map_err(load_error)?;
    ModelSpec::read(&inputs, &outputs, |key| metadata.custom(key), camera_size)
}

fn tensor_info(outlet: &Outlet) -> TensorInfo {
    TensorInfo {
        name: outlet.name().to_owned(),
        is_f32: outlet.dtype().tensor_type() == Some(TensorElementType::Float32),
        shape: outlet.dtype().tensor_shape().map(|shape| shape.to_vec()).unwrap_or_default(),
        description: outlet.dtype().to_string(),
    }
}
