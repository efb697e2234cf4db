//! Fits the network that chooses the depth of every cell (`runtime/src/perception/choice.rs`) to simulated homes with ground truth.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use firmware_host::config::Config;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::exploration::PolicyKind;
use simulator::{OpenOptions, World};

use crate::dense_fit::{Sparse, is_right, visit};
use crate::disturbance::Disturbance;
use crate::perceptron::{Perceptron, Sample};
use crate::sequence::{Motion, Sequence, simulated};

/// Homes that nothing else uses.
const HOMES: [&str; 16] = [
    "apartment?seed=41",
    "house?seed=42&texture=0.5",
    "office?seed=43&texture=0.1",
    "house?seed=44&stairs=1",
    "apartment?seed=45&texture=0.8",
    "office?seed=46",
    "apartment?seed=47&texture=0.1",
    "house?seed=48&texture=0.1",
    "apartment?seed=49&stairs=1",
    "house?seed=50",
    "office?seed=51&texture=0.5",
    "apartment?seed=52",
    "house?seed=53&texture=0.8",
    "office?seed=54&texture=0.3",
    "apartment?seed=55&texture=0.3",
    "house?seed=56&stairs=1&texture=0.1",
];
const MOTIONS: [Motion; 3] = [
    Motion::Policy(PolicyKind::Active),
    Motion::Policy(PolicyKind::Random),
    Motion::Policy(PolicyKind::Forward),
];
/// Pitch (degrees down) and height (m) of the camera; half of the cameras are the default one.
const MOUNTS: [(f64, f64); 6] =
    [(16.0, 0.8), (0.0, 0.8), (16.0, 0.8), (22.0, 1.1), (16.0, 0.8), (10.0, 0.4)];
const FRAMES: u64 = 250;
const SPARSE: Sparse = Sparse { every_frame: 5, every_cell: 7 };
const STEPS: usize = 6000;
const BATCH: usize = 4096;

/// Fits the weights and writes them into `file`.
///
/// # Errors
/// When a home cannot be simulated or the file cannot be written.
pub fn run(file: &Path) -> Result<()> {
    let mut sequences = Vec::new();
    for (index, home) in HOMES.iter().enumerate() {
        let config = config(index);
        let world = Arc::new(World::open(&format!("builtin:{home}"), &OpenOptions::default())?);
        for (disturbance, offset) in [(Disturbance::Pose, 0), (Disturbance::Rough, 1)] {
            let motion = MOTIONS[(index + offset) % MOTIONS.len()];
            eprintln!("{} of {}: {home}, {}", index + 1, HOMES.len(), motion.name());
            let sequence = simulated(&world, motion, FRAMES, 1, &config)?;
            for disturbance in [Disturbance::None, disturbance] {
                sequences.push(samples(&sequence, disturbance, &config)?);
            }
        }
    }
    let cells: usize = sequences.iter().map(Vec::len).sum();
    eprintln!("training with {cells} cells");
    let network = train(&sequences);
    std::fs::write(file, source(&network)).with_context(|| format!("writing {}", file.display()))
}

/// Other mounts, and every second camera with an automatic exposure under lamps and sun.
fn config(home: usize) -> Config {
    let mut config = Config::default();
    config.dense.choice = true;
    let (pitch_down_deg, height_m) = MOUNTS[home % MOUNTS.len()];
    config.camera.pitch_down_deg = pitch_down_deg;
    config.camera.height_m = height_m;
    if home % 2 == 1 {
        config.simulator.nuisances.exposure_drift_stops = 0.7;
        config.simulator.nuisances.flicker = 0.1;
        config.simulator.nuisances.sun_patches = 1.0;
        config.simulator.nuisances.sensor_noise = 3.0;
    }
    config
}

/// The cells of one sequence.
fn samples(sequence: &Sequence, disturbance: Disturbance, config: &Config) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    visit(sequence, disturbance, &config.coarse, &config.dense, SPARSE, |cell, truth_m| {
        let right = |inverse_depth| is_right(inverse_depth, truth_m);
        samples.extend(cell.choice.map(|choice| Sample {
            features: choice.features,
            right: choice.inverse_depth.map(|depth| (depth > 0.0).then(|| right(depth))),
        }));
    })?;
    Ok(samples)
}

/// Every sequence counts the same.
fn train(sequences: &[Vec<Sample>]) -> Perceptron {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut network = Perceptron::new(&mut random);
    let mut lately = 0.0;
    for step in 0..STEPS {
        let batch: Vec<&Sample> = (0..BATCH)
            .map(|_| {
                let cells = &sequences[random.random_range(0..sequences.len())];
                &cells[random.random_range(0..cells.len())]
            })
            .collect();
        let rate = 2.5e-3 * (1.0 + (std::f32::consts::PI * step as f32 / STEPS as f32).cos());
        let loss = network.step(&batch, rate);
        lately = if step == 0 { loss } else { 0.99 * lately + 0.01 * loss };
        if (step + 1) % (STEPS / 10) == 0 {
            eprintln!("step {} of {STEPS}: loss {lately:.4}", step + 1);
        }
    }
    network
}

/// The weights as Rust source.
fn source(network: &Perceptron) -> String {
    let mut text = String::from(
        "//! The weights of the choice. Written by `cargo xtask accuracy --fit-choice`.\n\
         // A weight may be near to a constant of mathematics by chance.\n\
         #![allow(clippy::approx_constant)]\n\n\
         use super::choice::{CANDIDATES, FEATURES, HIDDEN};\n",
    );
    matrix(&mut text, "WEIGHTS_1: [[f32; FEATURES]; HIDDEN]", &network.first().rows());
    vector(&mut text, "BIASES_1: [f32; HIDDEN]", &network.first().biases);
    matrix(&mut text, "WEIGHTS_2: [[f32; HIDDEN]; HIDDEN]", &network.second().rows());
    vector(&mut text, "BIASES_2: [f32; HIDDEN]", &network.second().biases);
    matrix(&mut text, "WEIGHTS_3: [[f32; HIDDEN]; CANDIDATES]", &network.third().rows());
    vector(&mut text, "BIASES_3: [f32; CANDIDATES]", &network.third().biases);
    text
}

fn matrix(text: &mut String, name: &str, rows: &[Vec<f32>]) {
    let _ = writeln!(text, "\n#[rustfmt::skip]\npub(super) const {name} = [");
    for row in rows {
        let _ = writeln!(text, "    [{}],", numbers(row));
    }
    text.push_str("];\n");
}

fn vector(text: &mut String, name: &str, values: &[f32]) {
    let _ = writeln!(text, "\n#[rustfmt::skip]\npub(super) const {name} = [{}];", numbers(values));
}

fn numbers(values: &[f32]) -> String {
    let values: Vec<String> = values.iter().map(|value| format!("{value:.4}")).collect();
    values.join(", ")
}
