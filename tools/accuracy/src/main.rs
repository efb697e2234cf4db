//! Prints the table of depth accuracy.
#![forbid(unsafe_code)]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use accuracy::choice_fit;
use accuracy::dense_fit::{self, is_right};
use accuracy::depth_network::{Input, Refined};
use accuracy::disturbance::Disturbance;
use accuracy::engine::{Coarse, Dense, Engine, FlowDepth, ScanAlone};
use accuracy::fit::Samples;
use accuracy::measure::{Outcome, measure};
use accuracy::sequence::{Motion, Sequence, recorded, simulated};
use anyhow::Result;
use clap::Parser;
use firmware_host::config::Config;
use hal::{CameraModel, ImageView};
use runtime::perception::confidence::{belief_features, vote_features};
use runtime::perception::surround::Surround;
use runtime::perception::{Belief, CoarseConfig, CoarseDepth, DenseConfig, Vote};
use simulator::{OpenOptions, World};

/// Measures the accuracy of depth on sequences with ground truth.
#[derive(Parser)]
struct Options {
    /// Scenes in which sequences are simulated: `builtin:` homes or files.
    #[arg(long = "scene")]
    scenes: Vec<String>,
    /// Folders of recorded sequences.
    #[arg(long = "dataset")]
    datasets: Vec<PathBuf>,
    /// Number of frames of each simulated sequence.
    #[arg(long, default_value_t = 150)]
    frames: u64,
    /// Simulate only these motions: forward, turning, random, active, rotation.
    #[arg(long, value_delimiter = ',')]
    motions: Vec<String>,
    /// Number of people who walk about in simulated scenes.
    #[arg(long, default_value_t = 0)]
    people: usize,
    /// Evaluate without disturbances only.
    #[arg(long)]
    undisturbed: bool,
    /// Fit the confidence instead, and print its weights for the `[coarse]` section of the configuration.
    #[arg(long)]
    fit: bool,
    /// Fit the probabilities of dense depth only, for the `[dense]` section.
    #[arg(long)]
    fit_dense: bool,
    /// Fit the choice among coarse, recalled and filled depth and walls to sixteen simulated homes, and write its weights into
    /// runtime/src/perception/choice_weights.rs. Takes ten minutes on two cores.
    #[arg(long)]
    fit_choice: bool,
    /// Configurations to compare; without any, the default configuration.
    #[arg(long = "config")]
    configs: Vec<PathBuf>,
    /// Evaluate the paper's method, too: flow to the fifth frame before by dense inverse search, then least squares.
    #[arg(long)]
    search: bool,
    /// Evaluate the paper's method with a learned flow, too: an ONNX model (`cargo xtask models` exports RAFT).
    #[arg(long)]
    flow_model: Option<PathBuf>,
    /// Evaluate a depth network, too, once given coarse depth as on the robot and once given dense depth.
    #[arg(long)]
    depth_model: Option<PathBuf>,
    /// Evaluate every N-th frame only; the learned flow is computed for no others.
    #[arg(long, default_value_t = 1)]
    every: usize,
    /// Folder for depth images of each sequence and the reliability diagram.
    #[arg(long)]
    out: Option<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    if options.fit_choice {
        let runtime = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../runtime");
        return choice_fit::run(&runtime.join("src/perception/choice_weights.rs"));
    }
    let sequences = sequences(&options)?;
    let mut configs = Vec::new();
    for path in &options.configs {
        configs.push((path.display().to_string(), Config::load(path)?));
    }
    if configs.is_empty() {
        configs.push(("coarse".to_owned(), Config::default()));
    }
    if options.fit_dense {
        let config = &configs[0].1;
        return fit_dense(&sequences, &config.coarse, &config.dense);
    }
    if options.fit {
        return fit(&sequences, &configs[0].1);
    }
    println!("{}", Outcome::head());
    for (name, config) in &configs {
        compare(&options, &sequences, options.out.as_deref(), |sequence| {
            Ok(Box::new(Coarse::new(name, config, sequence)?))
        })?;
    }
    for (name, config) in &configs {
        compare(&options, &sequences, None, |sequence| {
            let name = if options.configs.is_empty() { "dense" } else { name };
            Ok(Box::new(Dense::new(name, config, sequence)?))
        })?;
    }
    if sequences.iter().any(|sequence| sequence.mount.is_some()) {
        let config = &configs[0].1;
        compare(&options, &sequences, None, |sequence| {
            Ok(Box::new(ScanAlone::new(config, sequence)?))
        })?;
    }
    if let Some(model) = &options.depth_model {
        for input in [Input::Coarse, Input::Dense] {
            compare(&options, &sequences, None, |sequence| {
                Ok(Box::new(Refined::new(model, input, &configs[0].1, sequence)?))
            })?;
        }
    }
    if options.search {
        compare(&options, &sequences, None, |sequence| {
            Ok(Box::new(FlowDepth::search(sequence.camera)?))
        })?;
    }
    if let Some(model) = &options.flow_model {
        compare(&options, &sequences, None, |sequence| {
            Ok(Box::new(FlowDepth::network(model, sequence.camera)?))
        })?;
    }
    if let Some(folder) = &options.out {
        println!("Images are in {}.", folder.display());
    }
    Ok(())
}

fn sequences(options: &Options) -> Result<Vec<Sequence>> {
    let mut config = Config::default();
    config.simulator.nuisances.people = options.people;
    let mut sequences = Vec::new();
    for folder in &options.datasets {
        sequences.push(recorded(folder)?);
    }
    for scene in &options.scenes {
        let world = Arc::new(World::open(scene, &OpenOptions::default())?);
        for motion in Motion::ALL {
            if !options.motions.is_empty() && !options.motions.iter().any(|m| m == motion.name()) {
                continue;
            }
            eprintln!("simulating {scene}, {}", motion.name());
            sequences.push(simulated(&world, motion, options.frames, 1, &config)?);
        }
    }
    Ok(sequences)
}

fn compare(
    options: &Options,
    sequences: &[Sequence],
    out: Option<&Path>,
    engine: impl Fn(&Sequence) -> Result<Box<dyn Engine>>,
) -> Result<()> {
    let disturbances = if options.undisturbed { &Disturbance::ALL[..1] } else { &Disturbance::ALL };
    let mut all = Vec::new();
    for sequence in sequences {
        for disturbance in disturbances {
            let mut engine = engine(sequence)?;
            let sheet = out.filter(|_| *disturbance == Disturbance::None);
            let outcome =
                measure(sequence, *disturbance, engine.as_mut(), options.every.max(1), sheet)?;
            println!("{}", outcome.line());
            all.push(outcome);
        }
    }
    let mean = Outcome::mean(&all);
    println!("{}", mean.line());
    println!("{}", mean.calibration_line());
    if let Some(folder) = out {
        mean.reliability
            .draw(&format!("{}: confidence", mean.engine), &folder.join("reliability.png"))?;
    }
    Ok(())
}

/// Fits the confidence of votes first, then, with these weights, the confidence of beliefs.
fn fit(sequences: &[Sequence], config: &Config) -> Result<()> {
    let mut coarse = config.coarse.clone();
    coarse.vote_weights = fit_confidence(sequences, &coarse, |vote, _, _| {
        (vote.parallax_px > 0.0).then(|| (vote_features(vote), vote.inverse_depth))
    })?;
    println!("vote_weights = {:.2?}", coarse.vote_weights);
    coarse.belief_weights = fit_confidence(sequences, &coarse, |_, belief, around| {
        (belief.evidence > 0.0).then(|| (belief_features(belief, around), belief.inverse_depth))
    })?;
    println!("belief_weights = {:.2?}", coarse.belief_weights);
    fit_dense(sequences, &coarse, &config.dense)
}

/// Fits dense depth, with this coarse depth.
fn fit_dense(sequences: &[Sequence], coarse: &CoarseConfig, dense: &DenseConfig) -> Result<()> {
    let dense = dense_fit::fit(sequences, coarse, dense)?;
    println!("[dense]\nrecall_weights = {:.2?}", dense.recall_weights);
    println!("joint_weights = {:.2?}", dense.joint_weights);
    println!("fill_weights = {:.2?}", dense.fill_weights);
    println!("wall_weights = {:.2?}", dense.wall_weights);
    println!("seen_wall_weights = {:.2?}", dense.seen_wall_weights);
    println!("filled_wall_weights = {:.2?}", dense.filled_wall_weights);
    Ok(())
}

fn fit_confidence<const N: usize>(
    sequences: &[Sequence],
    coarse: &CoarseConfig,
    sample: impl Fn(&Vote, &Belief, &Surround) -> Option<([f32; N], f32)>,
) -> Result<[f32; N]> {
    let mut all = Samples::<N>::default();
    for sequence in sequences {
        for disturbance in [Disturbance::None, Disturbance::Pose] {
            all.add_sequence(samples(sequence, disturbance, coarse, &sample)?);
        }
    }
    Ok(all.fit()?.map(|weight| weight as f32))
}

fn samples<const N: usize>(
    sequence: &Sequence,
    disturbance: Disturbance,
    coarse: &CoarseConfig,
    sample: &impl Fn(&Vote, &Belief, &Surround) -> Option<([f32; N], f32)>,
) -> Result<Samples<N>> {
    let mut samples = Samples::default();
    let CameraModel { width, height, .. } = sequence.camera;
    let columns = width / 4;
    let mut engine =
        CoarseDepth::new(coarse.clone(), sequence.camera)?.with_floor(sequence.mount.is_some());
    for (index, view) in sequence.views.iter().enumerate() {
        let (rgb, pose) = disturbance.apply(index, view);
        let frame = ImageView::rgb8(width, height, &rgb)?;
        let Some(truth) = view.truth.as_ref().filter(|_| engine.estimate(frame, &pose).is_ok())
        else {
            continue;
        };
        // Neighbouring cells are correlated: every seventh is enough.
        let cells = engine.cells().enumerate().skip(index % 7).step_by(7);
        for (cell, (vote, belief, around)) in cells {
            let row = cell / columns * 4 + 1;
            let column = cell % columns * 4 + 1;
            let truth_m = truth.values()[row * width + column];
            let Some((features, inverse_depth)) = sample(vote, belief, around) else { continue };
            if truth_m > 0.0 {
                samples.add(features, is_right(inverse_depth, truth_m));
            }
        }
    }
    Ok(samples)
}
