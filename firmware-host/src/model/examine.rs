//! `firmware-host model examine`: the process that runs an untrusted model for the first time.
//!
//! The process limits its own memory, processor time and priority before it parses the model. It
//! reports each step on standard output, one JSON value per line, and the result at the end.
//! Whatever the model does to this process, the parent gets a reason to refuse it.

use std::io::{Read, Write};
use std::time::Instant;

use anyhow::{Context, Result};
use hal::{CameraModel, ImageView, Pose3};
use ort::environment::Environment;
use runtime::model_gate::{
    Examination, FrameScore, Latency, ScoredFrame, Scorer, Source, check_onnx_file,
};
use runtime::perception::{DepthNetwork, InputKind, NetworkOptions};
use rustix::process::{Resource, Rlimit, Signal, nice, set_parent_process_death_signal, setrlimit};
use serde::{Deserialize, Serialize};
use thread_priority::{NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy};

use super::ExamineArgs;
use super::evidence::{Sample, newest_segments, read_segment};
use crate::config::Config;
use crate::onnx_runtime;
use crate::setup::check_given;

/// Largest allowed difference from the golden output. It is ten times what the exporter allows
/// between PyTorch and ONNX Runtime, because other processors sum in another order.
const GOLDEN_TOLERANCE: f64 = 1e-2;
/// Minimum number of timed inferences, for a 99th percentile.
const LEAST_RUNS: usize = 100;
/// A slow model is timed for at most this long, milliseconds, with at least this number of runs.
const MOST_TIMED_MS: f64 = 10_000.0;
const SLOW_RUNS: usize = 10;

/// One line of the child's output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Report {
    /// The step that begins now.
    Doing(String),
    /// The model cannot be used on this robot.
    Unfit(Unfit),
    /// The examination is complete; these are its measurements.
    Examined(Examination),
}

/// Why a model cannot be used on this robot, independent of its accuracy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Unfit {
    /// The file is not an acceptable ONNX model.
    #[error("{0}")]
    File(String),
    /// The network does not load, has the wrong shapes, or fails to compute.
    #[error("{0}")]
    Network(String),
    /// The file contains no golden pair.
    #[error(
        "the model contains no golden pair; export it with `embodied-depth export`, which adds one"
    )]
    NoGoldenPair,
    /// The golden input gives another output than at export.
    #[error(
        "the model's golden output is off by {0:.4}, allowed: {GOLDEN_TOLERANCE}; it computes something else here than at export; export it again, or update ONNX Runtime"
    )]
    GoldenPair(f64),
}

/// Runs the examination, in the child process.
///
/// # Errors
/// If the examination is not possible at all. The parent shows the error.
pub fn run(args: &ExamineArgs) -> Result<()> {
    limit(args);
    send(&Report::Doing("reading the file".to_owned()))?;
    let config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    let mut candidate = Vec::new();
    std::io::stdin()
        .lock()
        .read_to_end(&mut candidate)
        .context("cannot read the candidate model from standard input")?;
    if let Err(fault) = check_onnx_file(&candidate) {
        return send(&Report::Unfit(Unfit::File(fault.to_string())));
    }
    send(&Report::Doing("loading it and running it on a grey image".to_owned()))?;
    let (environment, _) = onnx_runtime::init()?;
    let mut examiner = Examiner::new(&config, args);
    let loaded = examiner.load(&environment, &candidate);
    let mut candidate = match loaded {
        Ok(network) => network,
        Err(error) => return send(&Report::Unfit(Unfit::Network(error.to_string()))),
    };
    if let Err(why) = check_given(&candidate, &config) {
        return send(&Report::Unfit(Unfit::Network(why.to_string())));
    }
    send(&Report::Doing("running its golden pair".to_owned()))?;
    let golden_difference = match candidate.golden_difference() {
        Ok(Some(difference)) if f64::from(difference) <= GOLDEN_TOLERANCE => f64::from(difference),
        Ok(Some(difference)) => {
            return send(&Report::Unfit(Unfit::GoldenPair(f64::from(difference.min(f32::MAX)))));
        }
        Ok(None) => return send(&Report::Unfit(Unfit::NoGoldenPair)),
        Err(why) => {
            return send(&Report::Unfit(Unfit::Network(format!(
                "inference on the golden input failed ({why:?})"
            ))));
        }
    };
    let mut resident = match &args.resident {
        // A damaged resident model is ignored, as if there were none.
        Some(path) => {
            std::fs::read(path).ok().and_then(|bytes| examiner.load(&environment, &bytes).ok())
        }
        None => None,
    };
    send(&Report::Doing("evaluating it on held-out frames".to_owned()))?;
    examiner.judge(args, &config, &mut candidate, resident.as_mut())?;
    send(&Report::Doing("measuring its inference time".to_owned()))?;
    examiner.time(&mut candidate, resident.as_mut())?;
    let Examiner { frames, times, resident_times, .. } = examiner;
    let latency = latency(times);
    let resident_latency = resident.is_some().then(|| self::latency(resident_times));
    send(&Report::Examined(Examination { frames, latency, resident_latency, golden_difference }))
}

/// Limits the resources that a hostile model could take from the robot. A limit that the system
/// does not allow is skipped: the parent kills the process after its time limit anyway.
fn limit(args: &ExamineArgs) {
    for (resource, most) in [
        (Resource::As, args.memory_mib << 20),
        (Resource::Cpu, args.cpu_s),
        (Resource::Core, 0),
        // The process writes no files.
        (Resource::Fsize, 0),
    ] {
        if let Err(error) = setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) })
        {
            tracing::warn!("{resource:?} cannot be limited: {error}");
        }
    }
    // The result is useless without the parent, so this process ends with it.
    if let Err(error) = set_parent_process_death_signal(Some(Signal::KILL)) {
        tracing::warn!("this process will not end with its parent: {error}");
    }
    if args.idle {
        set_idle_priority();
    }
}

/// Sets idle priority for this thread and the threads that it starts.
fn set_idle_priority() {
    let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
    let thread = thread_priority::thread_native_id();
    if let Err(error) =
        thread_priority::set_thread_priority_and_policy(thread, ThreadPriority::Min, idle)
    {
        tracing::debug!("cannot set idle priority: {error:?}");
    }
    let _ = nice(19);
}

fn send(report: &Report) -> Result<()> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer(&mut out, report)?;
    out.write_all(b"\n")?;
    out.flush().context("the parent process is gone")
}

struct Examiner {
    camera: CameraModel,
    options: NetworkOptions,
    scorer: Scorer,
    frames: Vec<ScoredFrame>,
    /// Inference times of the candidate, milliseconds.
    times: Vec<f64>,
    resident_times: Vec<f64>,
}

impl Examiner {
    fn new(config: &Config, args: &ExamineArgs) -> Self {
        let camera = config.camera.model();
        let crate::config::NetworkSection { threads, spin, provider } = config.network;
        Self {
            camera,
            options: NetworkOptions { threads, spin, provider },
            scorer: Scorer::new(&camera, config.map.min_confidence),
            frames: Vec::with_capacity(args.frames),
            times: Vec::new(),
            resident_times: Vec::new(),
        }
    }

    fn load(
        &self,
        environment: &Environment,
        bytes: &[u8],
    ) -> Result<DepthNetwork, runtime::perception::NetworkError> {
        DepthNetwork::load(environment, bytes, &self.camera, self.options)
    }

    fn judge(
        &mut self,
        args: &ExamineArgs,
        config: &Config,
        candidate: &mut DepthNetwork,
        mut resident: Option<&mut DepthNetwork>,
    ) -> Result<()> {
        for segment in newest_segments(&args.recordings) {
            let more = read_segment(&segment, config, |sample| {
                self.score_both(sample, candidate, resident.as_deref_mut())?;
                Ok(self.frames.len() < args.frames)
            })?;
            if !more {
                break;
            }
        }
        Ok(())
    }

    fn score_both(
        &mut self,
        sample: &Sample<'_>,
        candidate: &mut DepthNetwork,
        resident: Option<&mut DepthNetwork>,
    ) -> Result<()> {
        let t_odom_target = sample.t_odom_camera;
        let sources: Vec<Source<'_>> = sample
            .sources
            .iter()
            .map(|(rgb, t_odom_source)| Source {
                rgb,
                t_source_target: t_odom_source.inverse() * t_odom_target,
            })
            .collect();
        let parallax_px = self.scorer.parallax_px(&sources);
        let (of_candidate, ms) = self.score(sample, &sources, candidate)?;
        self.times.push(ms);
        let of_resident = match resident {
            Some(network) => {
                let (score, ms) = self.score(sample, &sources, network)?;
                self.resident_times.push(ms);
                score
            }
            None => None,
        };
        let without_network = sample.dense.map(|dense| {
            self.scorer.score(sample.rgb, dense, sample.coarse, &sources, &sample.line)
        });
        self.frames.push(ScoredFrame {
            tick: sample.tick,
            bin: sample.bin,
            parallax_px,
            candidate: of_candidate,
            resident: of_resident,
            without_network,
        });
        Ok(())
    }

    /// Scores one model on one frame. Returns the score, if inference succeeded, and the inference
    /// time in milliseconds.
    fn score(
        &mut self,
        sample: &Sample<'_>,
        sources: &[Source<'_>],
        network: &mut DepthNetwork,
    ) -> Result<(Option<FrameScore>, f64)> {
        if matches!(network.spec().input, InputKind::RgbAndVolume { .. }) {
            // This network matches the frame with earlier ones, so it must see those first.
            for (rgb, t_odom_camera) in &sample.sources {
                let _ = network.estimate(sample.view(&self.camera, rgb)?, t_odom_camera, None);
            }
        }
        let view = sample.view(&self.camera, sample.rgb)?;
        let began = Instant::now();
        let given = sample.given(network.spec().given);
        let estimate = network.estimate(view, &sample.t_odom_camera, given);
        let ms = began.elapsed().as_secs_f64() * 1e3;
        let score = estimate.ok().map(|estimate| {
            self.scorer.score(sample.rgb, estimate, sample.coarse, sources, &sample.line)
        });
        Ok((score, ms))
    }

    /// Runs more inferences, alternating between the models, until there are enough for a 99th
    /// percentile.
    fn time(
        &mut self,
        candidate: &mut DepthNetwork,
        mut resident: Option<&mut DepthNetwork>,
    ) -> Result<()> {
        let rgb: Vec<u8> = (0..3 * self.camera.width * self.camera.height)
            .map(|i| (i * 7919 / 13 % 256) as u8)
            .collect();
        while self.times.len() < LEAST_RUNS {
            let view = ImageView::rgb8(self.camera.width, self.camera.height, &rgb)?;
            self.times.push(inference_ms(candidate, view));
            if let Some(resident) = resident.as_deref_mut() {
                self.resident_times.push(inference_ms(resident, view));
            }
            // Far above any budget, a precise percentile is not needed.
            if self.times.len() >= SLOW_RUNS && self.times.iter().sum::<f64>() > MOST_TIMED_MS {
                break;
            }
        }
        Ok(())
    }
}

/// Time of one inference without coarse depth, milliseconds.
fn inference_ms(network: &mut DepthNetwork, view: ImageView<'_>) -> f64 {
    let began = Instant::now();
    let _ = network.estimate(view, &Pose3::identity(), None);
    began.elapsed().as_secs_f64() * 1e3
}

fn latency(mut ms: Vec<f64>) -> Latency {
    ms.sort_by(f64::total_cmp);
    Latency { p50_ms: quantile(&ms, 0.5), p99_ms: quantile(&ms, 0.99), runs: ms.len() }
}

/// The value at a share of sorted values; NaN if there are none.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted
        .get((share * sorted.len().saturating_sub(1) as f64).ceil() as usize)
        .copied()
        .unwrap_or(f64::NAN)
}
