//! `firmware-host model examine`: the process that runs a model nobody has run yet.
//!
//! It limits itself (memory, processor time, priority) before it touches the file, says on standard output how far it is, one
//! JSON a line, and ends with what it found. Whatever the model does to it, the parent has a reason to refuse.

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

/// How far the golden output may be off: ten times what the exporter allows between PyTorch and ONNX Runtime, because other
/// processors sum in another order.
const GOLDEN_TOLERANCE: f64 = 1e-2;
/// Inferences that are timed at least.
const LEAST_RUNS: usize = 100;
/// Unless this time is over, milliseconds, and there are so many.
const MOST_TIMED_MS: f64 = 10_000.0;
const SLOW_RUNS: usize = 10;

/// What the child says, one a line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// What it is about to do.
    Doing(String),
    /// The model cannot be the robot's.
    Unfit(Unfit),
    /// Everything was measured.
    Examined(Examination),
}

/// Why a model cannot be the robot's, whatever its accuracy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Unfit {
    /// The file is not what a model may be.
    #[error("{0}")]
    File(String),
    /// It does not load, has the wrong shapes, or computes nothing.
    #[error("{0}")]
    Network(String),
    /// No golden pair.
    #[error(
        "the model holds no golden pair; export it with `embodied-depth export`, which puts one into the file"
    )]
    NoGoldenPair,
    /// Another output than when it was exported.
    #[error(
        "the model's golden output is off by {0:.4}, allowed: {GOLDEN_TOLERANCE}: it does not compute here what it did when it was exported; export it again, or update ONNX Runtime"
    )]
    GoldenPair(f64),
}

/// Runs in the child.
///
/// # Errors
/// What keeps it from examining at all: the parent shows it.
pub fn run(args: &ExamineArgs) -> Result<()> {
    limit(args);
    say(&Said::Doing("reading the file".to_owned()))?;
    let config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    let mut candidate = Vec::new();
    std::io::stdin().lock().read_to_end(&mut candidate).context("the candidate")?;
    if let Err(fault) = check_onnx_file(&candidate) {
        return say(&Said::Unfit(Unfit::File(fault.to_string())));
    }
    say(&Said::Doing("loading it and running it on a grey picture".to_owned()))?;
    let (environment, _) = onnx_runtime::init()?;
    let mut examiner = Examiner::new(&config, args);
    let loaded = examiner.load(&environment, &candidate);
    let mut candidate = match loaded {
        Ok(network) => network,
        Err(error) => return say(&Said::Unfit(Unfit::Network(error.to_string()))),
    };
    say(&Said::Doing("running its golden pair".to_owned()))?;
    let golden_difference = match candidate.golden_difference() {
        Ok(Some(difference)) if f64::from(difference) <= GOLDEN_TOLERANCE => f64::from(difference),
        Ok(Some(difference)) => {
            return say(&Said::Unfit(Unfit::GoldenPair(f64::from(difference.min(f32::MAX)))));
        }
        Ok(None) => return say(&Said::Unfit(Unfit::NoGoldenPair)),
        Err(why) => {
            return say(&Said::Unfit(Unfit::Network(format!(
                "it fails on its golden input ({why:?})"
            ))));
        }
    };
    let mut resident = match &args.resident {
        // A resident model that is damaged is none.
        Some(path) => {
            std::fs::read(path).ok().and_then(|bytes| examiner.load(&environment, &bytes).ok())
        }
        None => None,
    };
    say(&Said::Doing("judging it by held-out pictures".to_owned()))?;
    examiner.judge(args, &config, &mut candidate, resident.as_mut())?;
    say(&Said::Doing("measuring its time".to_owned()))?;
    examiner.time(&mut candidate, resident.as_mut())?;
    let Examiner { frames, times, resident_times, .. } = examiner;
    let latency = latency(times);
    let resident_latency = resident.is_some().then(|| self::latency(resident_times));
    say(&Said::Examined(Examination { frames, latency, resident_latency, golden_difference }))
}

/// Takes from itself what a hostile model could take from the robot. What the system does not allow to be limited stays as it is:
/// the parent ends the process when its time is over.
fn limit(args: &ExamineArgs) {
    let both = |most: u64| Rlimit { current: Some(most), maximum: Some(most) };
    for (resource, most) in [
        (Resource::As, args.memory_mib << 20),
        (Resource::Cpu, args.cpu_s),
        (Resource::Core, 0),
        // It writes no file.
        (Resource::Fsize, 0),
    ] {
        if let Err(error) = setrlimit(resource, both(most)) {
            tracing::warn!("{resource:?} cannot be limited: {error}");
        }
    }
    // Nobody waits for its word any more.
    if let Err(error) = set_parent_process_death_signal(Some(Signal::KILL)) {
        tracing::warn!("it will outlive its parent: {error}");
    }
    if args.idle {
        give_way();
    }
}

/// Only otherwise idle time, for this thread and those that it starts.
fn give_way() {
    let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
    let thread = thread_priority::thread_native_id();
    if let Err(error) =
        thread_priority::set_thread_priority_and_policy(thread, ThreadPriority::Min, idle)
    {
        tracing::debug!("no idle priority: {error:?}");
    }
    let _ = nice(19);
}

fn say(said: &Said) -> Result<()> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer(&mut out, said)?;
    out.write_all(b"\n")?;
    out.flush().context("the parent is gone")
}

struct Examiner {
    camera: CameraModel,
    options: NetworkOptions,
    scorer: Scorer,
    frames: Vec<ScoredFrame>,
    /// Milliseconds.
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
            scorer: Scorer::new(&camera),
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
            let camera = self.camera;
            let more = read_segment(&segment, &camera, &config.coarse, |sample| {
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
        let (candidate, resident) = (of_candidate, of_resident);
        self.frames.push(ScoredFrame {
            tick: sample.tick,
            bin: sample.bin,
            parallax_px,
            candidate,
            resident,
        });
        Ok(())
    }

    /// One model on one picture, and the time of its inference in milliseconds.
    fn score(
        &mut self,
        sample: &Sample<'_>,
        sources: &[Source<'_>],
        network: &mut DepthNetwork,
    ) -> Result<(Option<FrameScore>, f64)> {
        if matches!(network.spec().input, InputKind::RgbAndVolume { .. }) {
            // It compares with what it saw before.
            for (rgb, t_odom_camera) in &sample.sources {
                let _ = network.estimate(sample.view(&self.camera, rgb)?, t_odom_camera, None);
            }
        }
        let view = sample.view(&self.camera, sample.rgb)?;
        let began = Instant::now();
        let estimate = network.estimate(view, &sample.t_odom_camera, sample.coarse);
        let ms = began.elapsed().as_secs_f64() * 1e3;
        let score = estimate
            .ok()
            .map(|estimate| self.scorer.score(sample.rgb, estimate, sources, &sample.line));
        Ok((score, ms))
    }

    /// More inferences by turns until there are enough to speak of a 99th percentile.
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
            let timed = |network: &mut DepthNetwork| {
                let began = Instant::now();
                let _ = network.estimate(view, &Pose3::identity(), None);
                began.elapsed().as_secs_f64() * 1e3
            };
            self.times.push(timed(candidate));
            if let Some(resident) = resident.as_deref_mut() {
                self.resident_times.push(timed(resident));
            }
            // What is that slow need not be known to the hundredth.
            if self.times.len() >= SLOW_RUNS && self.times.iter().sum::<f64>() > MOST_TIMED_MS {
                break;
            }
        }
        Ok(())
    }
}

fn latency(mut ms: Vec<f64>) -> Latency {
    ms.sort_by(f64::total_cmp);
    let at = |share: f64| {
        ms.get((share * ms.len().saturating_sub(1) as f64).ceil() as usize)
            .copied()
            .unwrap_or(f64::NAN)
    };
    Latency { p50_ms: at(0.5), p99_ms: at(0.99), runs: ms.len() }
}
