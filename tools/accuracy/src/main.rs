//! Prints the accuracy table.
#![forbid(unsafe_code)]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use accuracy::disturbance::Disturbance;
use accuracy::engine::{Coarse, Engine, FlowDepth};
use accuracy::fit::Samples;
use accuracy::measure::{Outcome, measure};
use accuracy::sequence::{Motion, Sequence, recorded, simulated};
use anyhow::Result;
use clap::Parser;
use firmware_host::config::Config;
use hal::{CameraModel, ImageView};
use runtime::perception::surround::Surround;
use runtime::perception::trust::{belief_features, vote_features};
use runtime::perception::{Belief, CoarseConfig, CoarseDepth, Vote};
use simulator::{OpenOptions, World};

/// Measures depth on sequences with ground truth.
#[derive(Parser)]
struct Options {
    /// Scenes to drive through: `builtin:` homes or files.
    #[arg(long = "scene")]
    scenes: Vec<String>,
    /// Recorded sequences.
    #[arg(long = "dataset")]
    datasets: Vec<PathBuf>,
    /// Frames of each simulated sequence.
    #[arg(long, default_value_t = 150)]
    frames: u64,
    /// Only these motions: forward, turning, random, active, rotation.
    #[arg(long, value_delimiter = ',')]
    motions: Vec<String>,
    /// People who walk about in simulated scenes.
    #[arg(long, default_value_t = 0)]
    people: usize,
    /// Without disturbances.
    #[arg(long)]
    undisturbed: bool,
    /// Fits the confidence instead: prints the weights for the `[coarse]` section of the configuration.
    #[arg(long)]
    fit: bool,
    /// Configurations to compare; the default one where none is given.
    #[arg(long = "config")]
    configs: Vec<PathBuf>,
    /// Also the paper's way: flow to the fifth frame before, then least squares, with dense inverse search.
    #[arg(long)]
    search: bool,
    /// The same with a learned flow, an ONNX model (`cargo xtask models` exports RAFT).
    #[arg(long)]
    flow_model: Option<PathBuf>,
    /// Judge every so many frames; the learned flow looks at no others.
    #[arg(long, default_value_t = 1)]
    every: usize,
    /// Folder for one frame of each sequence and the reliability diagram.
    #[arg(long)]
    out: Option<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let sequences = sequences(&options)?;
    let mut configs = Vec::new();
    for path in &options.configs {
        configs.push((path.display().to_string(), Config::load(path)?));
    }
    if configs.is_empty() {
        configs.push(("coarse".to_owned(), Config::default()));
    }
    if options.fit {
        return fit(&sequences, &configs[0].1);
    }
    println!("{}", Outcome::head());
    for (name, config) in &configs {
        compare(&options, &sequences, options.out.as_deref(), |camera| {
            Ok(Box::new(Coarse::new(name, config, camera)?))
        })?;
    }
    if options.search {
        compare(&options, &sequences, None, |camera| Ok(Box::new(FlowDepth::search(camera)?)))?;
    }
    if let Some(model) = &options.flow_model {
        compare(&options, &sequences, None, |camera| {
            Ok(Box::new(FlowDepth::network(model, camera)?))
        })?;
    }
    if let Some(folder) = &options.out {
        println!("Look at {}.", folder.display());
    }
    Ok(())
}

fn sequences(options: &Options) -> Result<Vec<Sequence>> {
    let mut sequences = Vec::new();
    for folder in &options.datasets {
        sequences.push(recorded(folder)?);
    }
    for scene in &options.scenes {
        let world = Arc::new(World::open(scene, &OpenOptions::default())?);
        let wanted = |motion: &Motion| {
            options.motions.is_empty() || options.motions.iter().any(|m| m == motion.name())
        };
        for motion in Motion::ALL.into_iter().filter(wanted) {
            eprintln!("driving through {scene}, {}", motion.name());
            sequences.push(simulated(&world, motion, options.frames, 1, options.people)?);
        }
    }
    Ok(sequences)
}

fn compare(
    options: &Options,
    sequences: &[Sequence],
    out: Option<&Path>,
    engine: impl Fn(CameraModel) -> Result<Box<dyn Engine>>,
) -> Result<()> {
    let disturbances = if options.undisturbed { &Disturbance::ALL[..1] } else { &Disturbance::ALL };
    let mut all = Vec::new();
    for sequence in sequences {
        for disturbance in disturbances {
            let mut engine = engine(sequence.camera)?;
            let sheet = out.filter(|_| *disturbance == Disturbance::None);
            let outcome =
                measure(sequence, *disturbance, engine.as_mut(), options.every.max(1), sheet)?;
            println!("{}", outcome.line());
            all.push(outcome);
        }
    }
    let mean = Outcome::mean(&all);
    println!("{}", mean.line());
    if let Some(folder) = out {
        mean.reliability
            .draw(&format!("{}: confidence", mean.engine), &folder.join("reliability.png"))?;
    }
    Ok(())
}

/// Right is what delta1 calls right.
fn is_right(inverse_depth: f32, truth_m: f32) -> bool {
    let ratio = inverse_depth * truth_m;
    ratio > 0.8 && ratio < 1.25
}

/// First what one frame's vote is worth, then, with that, what is remembered.
fn fit(sequences: &[Sequence], config: &Config) -> Result<()> {
    let mut coarse = config.coarse.clone();
    coarse.vote_weights = gather(sequences, &coarse, |vote, _, _| {
        (vote.parallax_px > 0.0).then(|| (vote_features(vote), vote.inverse_depth))
    })?;
    println!("vote_weights = {:.2?}", coarse.vote_weights);
    coarse.belief_weights = gather(sequences, &coarse, |_, belief, around| {
        (belief.evidence > 0.0).then(|| (belief_features(belief, around), belief.inverse_depth))
    })?;
    println!("belief_weights = {:.2?}", coarse.belief_weights);
    Ok(())
}

fn gather<const N: usize>(
    sequences: &[Sequence],
    coarse: &CoarseConfig,
    sample: impl Fn(&Vote, &Belief, &Surround) -> Option<([f32; N], f32)>,
) -> Result<[f32; N]> {
    let mut all = Samples::<N>::default();
    for sequence in sequences {
        for disturbance in [Disturbance::None, Disturbance::Pose] {
            let mut samples = Samples::default();
            let mut engine = CoarseDepth::new(coarse.clone(), sequence.camera)?;
            for (index, view) in sequence.views.iter().enumerate() {
                let (rgb, pose) = disturbance.of(index, view);
                let frame = ImageView::rgb8(sequence.camera.width, sequence.camera.height, &rgb)?;
                let Some(truth) =
                    view.truth.as_ref().filter(|_| engine.estimate(frame, &pose).is_ok())
                else {
                    continue;
                };
                let columns = sequence.camera.width / 4;
                // Neighbours say the same: every seventh is enough.
                for (cell, (vote, belief, around)) in
                    engine.cells().enumerate().skip(index % 7).step_by(7)
                {
                    let row = cell / columns * 4 + 1;
                    let column = cell % columns * 4 + 1;
                    let truth_m = truth.values()[row * sequence.camera.width + column];
                    if let Some((features, inverse_depth)) =
                        sample(vote, belief, around).filter(|_| truth_m > 0.0)
                    {
                        samples.add(features, is_right(inverse_depth, truth_m));
                    }
                }
            }
            all.add_sequence(samples);
        }
    }
    Ok(all.fit()?.map(|weight| weight as f32))
}
