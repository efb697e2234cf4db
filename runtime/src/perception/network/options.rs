//! How a model is run: threads and execution provider.

use ort::environment::Environment;
use ort::ep::{self, ExecutionProvider};
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use serde::{Deserialize, Serialize};
use std::num::NonZeroUsize;

use super::NetworkError;

/// Threads and execution provider.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetworkOptions {
    /// Threads of one inference, at least 1.
    pub threads: usize,
    /// Whether threads spin while they wait for the next layer, which saves some microseconds per layer. They stop when the run
    /// ends, so that they take no processor time from the control loop between two frames.
    pub spin: bool,
    pub provider: Provider,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self { threads: 1, spin: true, provider: Provider::Cpu }
    }
}

/// Execution providers of ONNX Runtime. The loaded library determines which are available. Operators that a provider does not
/// support run on the CPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Provider {
    /// ONNX Runtime's own kernels.
    #[default]
    Cpu,
    /// XNNPACK, for ARM processors, with its own threads.
    Xnnpack,
    Cuda,
    /// An NVIDIA GPU with an engine that is compiled when the model is loaded; unsupported operators run with CUDA.
    TensorRt,
}

impl Provider {
    const ALL: [Self; 4] = [Self::Cpu, Self::Xnnpack, Self::Cuda, Self::TensorRt];

    /// Its name in the configuration.
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

    /// Gives the provider priority over the CPU.
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

/// A configured session without a model. An unavailable provider is an error, because a robot that silently falls back to its
/// CPU misses its deadlines.
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
    // XNNPACK has its own threads; a second set would only wait for them.
    let own_threads = if options.provider == Provider::Xnnpack { 1 } else { threads.get() };
    Ok(SessionBuilder::new(onnx_runtime)?
        .with_intra_threads(own_threads)?
        // Layers run one after the other.
        .with_parallel_execution(false)?
        .with_intra_op_spinning(options.spin)?
        // By default, threads continue to spin after the run, for up to a millisecond.
        .with_config_entry("session.force_spinning_stop", "1")?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_deterministic_compute(true)?)
}
