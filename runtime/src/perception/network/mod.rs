//! Depth networks: ONNX models that ONNX Runtime runs.
//!
//! A model describes its inputs and its output by their shapes and by metadata:
//!
//! | key | meaning | without it |
//! |---|---|---|
//! | `kind` | `rgb`, `rgb+coarse` or `rgb+volume` | names and shapes of the inputs |
//! | `given_depth` | `coarse` or `dense`: the depth that the coarse input takes | `coarse` |
//! | `output` | `depth` or `disparity` | name of the output |
//! | `min_depth_m`, `max_depth_m` | range of the output, metres | 0.1, 20 |
//! | `volume_min_depth_m`, `volume_max_depth_m` | nearest and farthest plane of the cost volume, metres | 0.3, 20 |
//! | `input_width`, `input_height` | size of the image | shape of the input |
//! | `version` | name and version of the model | |
//! | `golden_input`, `golden_output` | an input and the output that belongs to it | |
//!
//! All keys are optional. They are checked when the model is loaded, together with one run on a grey image. Inputs and outputs
//! are 32-bit or 16-bit floats.
//!
//! On the CPU, the same frames give the same depth, bit for bit, on any number of threads. A call allocates nothing in this
//! crate and copies no tensor; `bound` describes what ort and ONNX Runtime allocate. The runtime reads no clock: the caller
//! measures the latency, in a [`LatencyHistogram`](crate::latency::LatencyHistogram).

mod bound;
mod error;
mod golden;
mod options;
mod planes;
mod spec;
#[cfg(test)]
mod tests;
mod volume;

pub use error::NetworkError;
pub use options::{NetworkOptions, Provider};
pub use spec::{DEFAULT_DEPTH_RANGE_M, GivenDepth, InputKind, ModelSpec, OutputKind};

use hal::{CameraModel, ImageView, PixelFormat, Pose3};
use ort::environment::Environment;

use super::{DepthEstimate, NoDepth};
use crate::snapshot::{SnapshotError, State};
use bound::{BoundSession, Model};
use golden::Golden;
use volume::CostVolume;

/// Indices of the inputs in `ModelSpec::input_ports`.
const IMAGE: usize = 0;
const SECOND: usize = 1;
/// A loaded model with its bound memory. One call of [`estimate`](Self::estimate) blocks for one inference.
#[derive(Debug)]
pub struct DepthNetwork {
    spec: ModelSpec,
    digest: String,
    session: BoundSession,
    /// The cost volume, for models with one as input.
    volume: Option<CostVolume>,
    golden: Option<Golden>,
    estimate: DepthEstimate,
    refused: u64,
}

impl DepthNetwork {
    /// Loads a model from the bytes of its file, for frames of `camera`, and runs it once.
    ///
    /// # Errors
    /// See [`NetworkError`].
    pub fn load(
        onnx_runtime: &Environment,
        model: &[u8],
        camera: &CameraModel,
        options: NetworkOptions,
    ) -> Result<Self, NetworkError> {
        let width = camera.width;
        let height = camera.height;
        let loaded = Model::load(onnx_runtime, model, options)?;
        let spec =
            ModelSpec::read(&loaded.inputs, &loaded.outputs, loaded.metadata()?, (width, height))?;
        let golden = Golden::read(&loaded.metadata()?, &spec.input_ports, spec.size)?;
        let volume = match spec.input {
            InputKind::RgbAndVolume { planes, range_m } => {
                Some(CostVolume::new(camera, planes, range_m))
            }
            _ => None,
        };
        let session = loaded.bind(&spec.input_ports, &spec.output_port)?;
        let digest = blake3::hash(model).to_hex().to_string();
        let estimate = DepthEstimate::none(width, height);
        let mut network = Self { spec, digest, session, volume, golden, estimate, refused: 0 };
        network.warm_up()?;
        Ok(network)
    }

    /// The first run makes ONNX Runtime allocate its memory, and shows whether the model works at all. The other inputs are
    /// still 0: no coarse depth, no evidence in the cost volume.
    fn warm_up(&mut self) -> Result<(), NetworkError> {
        let pixels = 3 * self.spec.size.0 * self.spec.size.1;
        self.session.write(IMAGE, |planes| planes[..pixels].fill(0.5));
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

    /// Runs the golden input and returns the largest difference of the output from the golden output, which was computed when
    /// the model was exported (in the model's own unit: x in 0..1 or metres). `None` if the model has no golden pair,
    /// infinity if the output contains NaN.
    ///
    /// # Errors
    /// [`NoDepth::NetworkOutput`] when the model fails.
    pub fn golden_difference(&mut self) -> Result<Option<f32>, NoDepth> {
        let Self { spec, session, golden, .. } = self;
        let Some(golden) = golden else { return Ok(None) };
        let mut before = 0;
        for (input, port) in spec.input_ports.iter().enumerate() {
            session.write(input, |planes| golden.write(port, before, planes));
            before += port.shape[1];
        }
        let difference = session.run(|output| golden.difference(output, spec.size.0));
        difference.map(Some).map_err(|error| {
            tracing::error!(%error, "the depth network failed on its golden input");
            NoDepth::NetworkOutput
        })
    }

    /// Depth of one RGB8 frame of the camera's size, taken at `t_odom_camera`. `given` is the frame's depth of the kind that the
    /// model asks for ([`ModelSpec::given`]). Models with coarse depth as input get planes of zeros where it is `None`; others
    /// ignore it. Models with a cost volume compare with the frames of earlier calls; others ignore the pose.
    ///
    /// # Errors
    /// [`NoDepth::FrameSize`] for another size or format; [`NoDepth::PoseNotFinite`] where the pose is needed;
    /// [`NoDepth::NetworkOutput`] when the model fails or its output contains NaN or values out of its range. All are counted
    /// by [`refused`](Self::refused).
    pub fn estimate(
        &mut self,
        frame: ImageView<'_>,
        t_odom_camera: &Pose3,
        given: Option<&DepthEstimate>,
    ) -> Result<&DepthEstimate, NoDepth> {
        match self.try_estimate(frame, t_odom_camera, given) {
            Ok(()) => Ok(&self.estimate),
            Err(why) => {
                self.refused += 1;
                self.estimate.clear();
                Err(why)
            }
        }
    }

    fn try_estimate(
        &mut self,
        frame: ImageView<'_>,
        t_odom_camera: &Pose3,
        given: Option<&DepthEstimate>,
    ) -> Result<(), NoDepth> {
        let size = self.spec.size;
        if frame.format() != PixelFormat::Rgb8
            || (frame.width(), frame.height()) != size
            || given.is_some_and(|c| (c.depth.width(), c.depth.height()) != size)
        {
            return Err(NoDepth::FrameSize);
        }
        self.write_inputs(frame.data(), t_odom_camera, given)?;
        match self.run() {
            Ok(true) => Ok(()),
            Ok(false) => Err(NoDepth::NetworkOutput),
            Err(error) => {
                tracing::error!(%error, "the depth network failed");
                Err(NoDepth::NetworkOutput)
            }
        }
    }

    fn write_inputs(
        &mut self,
        rgb: &[u8],
        pose: &Pose3,
        given: Option<&DepthEstimate>,
    ) -> Result<(), NoDepth> {
        let range_m = self.spec.depth_range_m;
        let joined = self.spec.input == InputKind::RgbCoarseJoined;
        self.session.write(IMAGE, |planes| {
            let (image, rest) = planes.split_at_mut(rgb.len());
            planes::write_rgb(rgb, image);
            if joined {
                planes::write_coarse(given, range_m, rest);
            }
        });
        if self.spec.input == InputKind::RgbAndCoarse {
            self.session.write(SECOND, |planes| planes::write_coarse(given, range_m, planes));
        }
        if let Some(volume) = &mut self.volume {
            if !pose.to_matrix().iter().all(|number| number.is_finite()) {
                return Err(NoDepth::PoseNotFinite);
            }
            self.session.write(SECOND, |planes| volume.compute(rgb, pose, planes));
        }
        Ok(())
    }

    /// One inference over the bound memory; `false` if its output is invalid.
    fn run(&mut self) -> ort::Result<bool> {
        let Self { spec, session, estimate, .. } = self;
        session.run(|output| planes::read_output(output, spec, estimate))
    }

    /// Limits the confidence of the last estimate where `seen` has no depth. The robot does this for models that are given dense
    /// depth, with coarse depth as `seen`.
    pub fn doubt_unseen(&mut self, seen: Option<&DepthEstimate>) {
        self.estimate.doubt_unseen(seen);
    }

    /// The result of the last [`estimate`](Self::estimate); without any depth if it failed.
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    /// The model's inputs and output.
    #[must_use]
    pub fn spec(&self) -> &ModelSpec {
        &self.spec
    }

    /// BLAKE3 digest of the model's bytes, in hex.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Number of frames that got no depth.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

/// Stores only the keyframes of the cost volume. The caller checks that the snapshot belongs to the same model.
impl State for DepthNetwork {
    fn write(&self, to: &mut Vec<u8>) {
        if let Some(volume) = &self.volume {
            volume.write(to);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.volume.as_mut().map_or(Ok(()), |volume| volume.read(from))
    }
}
