//! How a model is run: threads, and whose kernels.

use ort::environment::Environment;
use ort::ep::{self, ExecutionProvider};
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use serde::{Deserialize, Serialize};
use std::num::NonZeroUsize;

use super::NetworkError;

/// How a model is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetworkOptions {
    /// Threads of one inference, at least 1.
    pub threads: usize,
    /// Whether threads spin while they wait for the next layer. Faster by some microseconds a layer. They stop when the run
    /// ends, so that nothing is taken from the control loop between two pictures.
    pub spin: bool,
    /// Whose kernels compute.
    pub provider: Provider,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self { threads: 1, spin: true, provider: Provider::Cpu }
    }
}

/// Execution providers of ONNX Runtime. Which of them there are depends on the library that is loaded. What a provider cannot
/// compute, ONNX Runtime computes on the CPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Provider {
    /// ONNX Runtime's own kernels.
    #[default]
    Cpu,
    /// XNNPACK, for ARM processors, with threads of its own.
    Xnnpack,
    /// An NVIDIA GPU.
    Cuda,
    /// An NVIDIA GPU with an engine that is compiled for it when the model is loaded; CUDA computes the rest.
    TensorRt,
}

impl Provider {
    const ALL: [Self; 4] = [Self::Cpu, Self::Xnnpack, Self::Cuda, Self::TensorRt];

    /// As in the configuration.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Xnnpack => "xnnpack",
            Self::Cuda => "cuda",
            Self::TensorRt => "tensorrt",
        }
    }

    /// Whether inputs must be copied to the provider's own memory before every run.
    pub(super) fn has_own_memory(self) -> bool {
        matches!(self, Self::Cuda | Self::TensorRt)
    }

    fn is_available(self) -> bool {
        match self {
            Self::Cpu => Ok(true),
            Self::Xnnpack => ep::XNNPACK::is_available(),
            Self::Cuda => ep::CUDA::is_available(),
            Self::TensorRt => ep::TensorRT::is_available(),
        }
        .unwrap_or(false)
    }

    /// Puts the provider first in line; the CPU is always last.
    fn register(self, threads: NonZeroUsize, builder: &mut SessionBuilder) -> ort::Result<()> {
        match self {
            Self::Cpu => Ok(()),
            Self::Xnnpack => {
                ep::XNNPACK::default().with_intra_op_num_threads(threads).register(builder)
            }
            Self::Cuda => ep::CUDA::default().register(builder),
            Self::TensorRt => {
                ep::TensorRT::default().register(builder)?;
                ep::CUDA::default().register(builder)
            }
        }
    }
}

/// A session that is set up, but has no model yet. A provider that is not there is an error: a robot that silently falls back
/// to its CPU misses its deadlines.
pub(super) fn session_builder(
    onnx_runtime: &Environment,
    options: NetworkOptions,
) -> Result<SessionBuilder, NetworkError> {
    let provider = options.provider;
    if !provider.is_available() {
        let available = Provider::ALL
            .into_iter()
            .filter(|provider| provider.is_available())
            .map(Provider::name);
        let available = available.collect::<Vec<_>>().join(", ");
        return Err(NetworkError::NoProvider { wanted: provider.name(), available });
    }
    let threads = NonZeroUsize::new(options.threads).unwrap_or(NonZeroUsize::MIN);
    let mut builder = plain_builder(onnx_runtime, threads, options).map_err(|error| {
        NetworkError::Options { threads: options.threads, reason: error.to_string() }
    })?;
    provider.register(threads, &mut builder).map_err(|error| NetworkError::Provider {
        wanted: provider.name(),
        reason: error.to_string(),
    })?;
    Ok(builder)
}

fn plain_builder(
    onnx_runtime: &Environment,
    threads: NonZeroUsize,
    options: NetworkOptions,
) -> ort::Result<SessionBuilder> {
    // XNNPACK has threads of its own; a second set would only wait for it.
    let own_threads = if options.provider == Provider::Xnnpack { 1 } else { threads.get() };
    Ok(SessionBuilder::new(onnx_runtime)?
        .with_intra_threads(own_threads)?
        // One layer after the other.
        .with_parallel_execution(false)?
        .with_intra_op_spinning(options.spin)?
        // By default they would go on after the run, for up to a millisecond.
        .with_config_entry("session.force_spinning_stop", "1")?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_deterministic_compute(true)?)
}
