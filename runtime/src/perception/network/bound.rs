//! A session whose inputs and output are bound once and keep their memory from run to run.
//!
//! Only owned tensors are bound: binding a borrowed one deadlocks in ort 2.0.0-rc.15. A run allocates nothing in this crate;
//! ort's own `run_binding` makes two small allocations for the output that it returns, and ONNX Runtime (C++) allocates memory
//! of its own.

use half::f16;
use half::slice::HalfFloatSliceExt;
use ort::environment::Environment;
use ort::memory::Allocator;
use ort::session::{IoBinding, Session};
use ort::value::{Outlet, Tensor, TensorElementType};

use super::error::{self, NetworkError};
use super::options::{NetworkOptions, session_builder};

/// Element types of inputs and outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Float {
    Single,
    /// 16-bit floats, IEEE 754 binary16.
    Half,
}

/// A tensor as the model describes it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TensorInfo {
    pub name: String,
    /// `None` for other element types.
    pub float: Option<Float>,
    /// Sizes; -1 for a dynamic dimension.
    pub shape: Vec<i64>,
    /// Type and shape as text.
    pub description: String,
}

impl TensorInfo {
    fn of(outlet: &Outlet) -> Self {
        Self {
            name: outlet.name().to_owned(),
            float: match outlet.dtype().tensor_type() {
                Some(TensorElementType::Float32) => Some(Float::Single),
                Some(TensorElementType::Float16) => Some(Float::Half),
                _ => None,
            },
            shape: outlet.dtype().tensor_shape().map(|shape| shape.to_vec()).unwrap_or_default(),
            description: outlet.dtype().to_string(),
        }
    }

    /// Size of one dimension, `default` if it is dynamic.
    pub fn size(&self, dimension: usize, default: i64) -> i64 {
        self.shape.get(dimension).copied().filter(|size| *size >= 0).unwrap_or(default)
    }

    pub fn text(&self) -> String {
        format!("`{}` {}", self.name, self.description)
    }
}

/// An input or output as it is bound: every size is known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Port {
    pub name: String,
    pub float: Float,
    /// `[1, channels, rows, columns]`.
    pub shape: [usize; 4],
}

impl Port {
    fn len(&self) -> usize {
        self.shape.iter().product()
    }
}

/// A loaded model without bound memory.
#[derive(Debug)]
pub(super) struct Model {
    session: Session,
    pub inputs: Vec<TensorInfo>,
    pub outputs: Vec<TensorInfo>,
    has_own_memory: bool,
}

impl Model {
    pub fn load(
        onnx_runtime: &Environment,
        bytes: &[u8],
        options: NetworkOptions,
    ) -> Result<Self, NetworkError> {
        if let Some(found) = error::other_kind(bytes) {
            return Err(NetworkError::NotOnnx { found });
        }
        let session = session_builder(onnx_runtime, options)?
            .commit_from_memory(bytes)
            .map_err(load_error)?;
        let inputs = session.inputs().iter().map(TensorInfo::of).collect();
        let outputs = session.outputs().iter().map(TensorInfo::of).collect();
        Ok(Self { session, inputs, outputs, has_own_memory: options.provider.has_own_memory() })
    }

    /// A function that returns the model's metadata for a key.
    pub fn metadata(&self) -> Result<impl Fn(&str) -> Option<String> + '_, NetworkError> {
        let metadata = self.session.metadata().map_err(load_error)?;
        Ok(move |key: &str| metadata.custom(key))
    }

    /// Allocates and binds the memory of every input and of the output.
    pub fn bind(self, inputs: &[Port], output: &Port) -> Result<BoundSession, NetworkError> {
        self.try_bind(inputs, output).map_err(load_error)
    }

    fn try_bind(self, inputs: &[Port], output: &Port) -> ort::Result<BoundSession> {
        let mut binding = self.session.create_binding()?;
        let inputs = inputs.iter().map(Input::new).collect::<ort::Result<Vec<_>>>()?;
        for input in &inputs {
            input.bind(&mut binding)?;
        }
        let name = output.name.as_str();
        let mut converted = Vec::new();
        match output.float {
            Float::Single => binding
                .bind_output(name, Tensor::<f32>::new(&Allocator::default(), output.shape)?)?,
            Float::Half => {
                binding
                    .bind_output(name, Tensor::<f16>::new(&Allocator::default(), output.shape)?)?;
                converted = vec![0.0; output.len()];
            }
        }
        let Self { session, has_own_memory, .. } = self;
        Ok(BoundSession {
            session,
            binding,
            inputs,
            float: output.float,
            converted,
            has_own_memory,
        })
    }
}

/// Inference over bound memory: inputs are written first, then [`run`](Self::run) computes and reads the output.
#[derive(Debug)]
pub(super) struct BoundSession {
    session: Session,
    binding: IoBinding,
    inputs: Vec<Input>,
    /// Element type of the output.
    float: Float,
    /// The output as 32-bit floats, if the model's has 16.
    converted: Vec<f32>,
    has_own_memory: bool,
}

impl BoundSession {
    /// Lets `fill` write the planes of an input, by its index in the order of binding. Planes keep their values until they are
    /// written again.
    pub fn write(&mut self, input: usize, fill: impl FnOnce(&mut [f32])) {
        if let Some(input) = self.inputs.get_mut(input) {
            input.write(fill);
        }
    }

    /// Runs one inference and passes its output to `read`.
    pub fn run<T>(&mut self, read: impl FnOnce(&[f32]) -> T) -> ort::Result<T> {
        if self.has_own_memory {
            // Binding copies the inputs to the provider's memory.
            for input in &self.inputs {
                input.bind(&mut self.binding)?;
            }
            self.binding.synchronize_inputs()?;
        }
        let outputs = self.session.run_binding(&self.binding)?;
        if self.has_own_memory {
            self.binding.synchronize_outputs()?;
        }
        match self.float {
            Float::Single => Ok(read(outputs[0].try_extract_tensor::<f32>()?.1)),
            Float::Half => {
                outputs[0].try_extract_tensor::<f16>()?.1.convert_to_f32_slice(&mut self.converted);
                Ok(read(&self.converted))
            }
        }
    }
}

/// An input with its memory.
#[derive(Debug)]
struct Input {
    name: String,
    tensor: InputTensor,
}

#[derive(Debug)]
enum InputTensor {
    Single(Tensor<f32>),
    /// Written as 32-bit floats, then converted.
    Half(Tensor<f16>, Vec<f32>),
}

impl Input {
    fn new(port: &Port) -> ort::Result<Self> {
        let len = port.len();
        let tensor = match port.float {
            Float::Single => InputTensor::Single(Tensor::from_array((port.shape, vec![0.0; len]))?),
            Float::Half => InputTensor::Half(
                Tensor::from_array((port.shape, vec![f16::ZERO; len]))?,
                vec![0.0; len],
            ),
        };
        Ok(Self { name: port.name.clone(), tensor })
    }

    fn bind(&self, binding: &mut IoBinding) -> ort::Result<()> {
        match &self.tensor {
            InputTensor::Single(tensor) => binding.bind_input(self.name.as_str(), tensor),
            InputTensor::Half(tensor, _) => binding.bind_input(self.name.as_str(), tensor),
        }
    }

    fn write(&mut self, fill: impl FnOnce(&mut [f32])) {
        match &mut self.tensor {
            InputTensor::Single(tensor) => fill(tensor.extract_tensor_mut().1),
            InputTensor::Half(tensor, planes) => {
                fill(planes);
                tensor.extract_tensor_mut().1.convert_from_f32_slice(planes);
            }
        }
    }
}

fn load_error(error: impl std::fmt::Display) -> NetworkError {
    NetworkError::Load { reason: error.to_string() }
}
