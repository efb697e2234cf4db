//! Chooses the depth of every cell among those that it could have.
//!
//! A cell has up to four candidates: coarse depth of this frame, depth that the voxel map recalls, depth that is filled in from the cells
//! around, and the wall or floor that the scan promises. A small network (two hidden layers) states for each candidate how
//! probable it is that it is right (within 25 %). It knows how the candidates relate to each other, how each of them came about, and how they
//! relate in the cells around: of a blank wall, the scan is right and coarse depth wrong, at a table it is the other way round. The most
//! probable candidate is chosen; if the wall or coarse depth agrees with it, that one, because it is more precise.
//!
//! Its weights are in `choice_weights.rs`. They were fitted to the ground truth of simulated homes (`cargo xtask accuracy --fit-choice`),
//! like all probabilities of coarse and dense depth. A robot that drives needs no ground truth.

use multiversion::multiversion;
use rayon::prelude::*;

use super::belief::Belief;
use super::choice_weights::{BIASES_1, BIASES_2, BIASES_3, WEIGHTS_1, WEIGHTS_2, WEIGHTS_3};
use super::dense::agree;
use super::fill::{Carried, Filled};
use super::surround::Surround;
use super::walls::Wall;
use super::wta::Vote;

/// Number of candidates: coarse, recalled, filled, wall.
pub const CANDIDATES: usize = 4;
/// Number of features of a cell alone.
const OWN: usize = 36;
/// These of its features are averaged over the cells around it: how the candidates relate to the reference, how probable coarse and
/// recalled depth are and whether their neighbours agree, and how many walls agree.
const AVERAGED: [usize; 8] = [1, 3, 5, 8, 12, 18, 22, 26];
/// Number of inputs of the network.
pub const FEATURES: usize = OWN + AVERAGED.len();
/// Width of both hidden layers. With 24 or 32, no more depths were right in 13 sequences that were not fitted.
pub const HIDDEN: usize = 16;
/// Neurons of all layers.
const NEURONS: usize = 2 * HIDDEN + CANDIDATES;
/// Cells to each side that are averaged. Beyond the edge of the image, the last cells are repeated.
const REACH: usize = 8;

/// Everything that is known about one cell before the choice.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// Coarse depth, its neighbourhood and its probability.
    pub coarse: (Belief, Surround, f32),
    /// The vote of this frame alone; `None` if it was not matched with earlier ones.
    pub vote: Option<Vote>,
    /// Recalled depth, its neighbourhood and its probability.
    pub recalled: (Belief, Surround, f32),
    pub filled: Filled,
    /// What was carried into the cell from the four sides.
    pub sides: [Carried; 4],
    /// What the scan tells, and the share of the cells around that agree with their walls.
    pub wall: (Wall, f32),
}

impl Cell {
    /// The inverse depth of every candidate, 1/m; 0 where there is none.
    fn candidates(&self) -> [f32; CANDIDATES] {
        let believed = |(belief, _, probability): &(Belief, Surround, f32)| match *probability > 0.0
        {
            true => belief.inverse_depth,
            false => 0.0,
        };
        [
            believed(&self.coarse),
            believed(&self.recalled),
            self.filled.inverse_depth,
            self.wall.0.inverse_depth,
        ]
    }

    /// Features are 0 where they do not apply. Factors bring them to a similar range.
    fn features(&self) -> [f32; OWN] {
        let [coarse, recalled, filled, wall] = self.candidates();
        let reference = ln(match wall > 0.0 {
            true => wall,
            false if filled > 0.0 => filled,
            false => NO_REFERENCE,
        });
        let relation = |inverse_depth: f32| match inverse_depth > 0.0 {
            true => 2.0 * (ln(inverse_depth) - reference).clamp(-2.0, 2.0),
            false => 0.0,
        };
        let is = |condition: bool| f32::from(u8::from(condition));
        let mut all = [0.0; OWN];
        all[0] = is(coarse > 0.0);
        all[1] = relation(coarse);
        all[2] = is(recalled > 0.0);
        all[3] = relation(recalled);
        all[4] = is(filled > 0.0);
        all[5] = relation(filled);
        all[6] = is(wall > 0.0);
        all[7] = reference;
        all[8..13].copy_from_slice(&belief(&self.coarse));
        if let Some(vote) = self.vote.filter(|vote| vote.parallax_px > 0.0) {
            all[13] = relation(vote.inverse_depth);
            all[14] = 2.0 * vote.margin;
            all[15] = 0.3 * ln(vote.parallax_px + 0.5);
            all[16] = 0.5 * ln(vote.texture + 0.01);
            all[17] = vote.misfit;
        }
        all[18..23].copy_from_slice(&belief(&self.recalled));
        if filled > 0.0 {
            all[23] = distance(self.filled.cost);
            all[24] = self.filled.spread.min(2.0);
            all[25] = is(self.filled.is_seen());
        }
        if wall > 0.0 {
            all[26] = 0.7 * logit(self.wall.1);
            all[27] = is(self.wall.0.is_floor);
        }
        for (two, side) in all[28..].chunks_exact_mut(2).zip(&self.sides) {
            if side.inverse_depth > 0.0 {
                two[0] = relation(side.inverse_depth);
                two[1] = distance(side.cost);
            }
        }
        all
    }
}

/// Inverse depth to which candidates are related where there is neither a wall nor a filled depth, 1/m.
const NO_REFERENCE: f32 = 0.4;

/// The features of a belief: probability, mean confidence of its votes, their number, and its neighbourhood.
fn belief((belief, around, probability): &(Belief, Surround, f32)) -> [f32; 5] {
    let is_known = *probability > 0.0;
    let if_known = |value: f32| if is_known { value } else { 0.0 };
    [
        if_known(0.5 * logit(*probability)),
        if_known(belief.mean_confidence()),
        if_known(0.5 * ln(1.0 + belief.votes.max(0.0))),
        around.confidence,
        around.agreeing,
    ]
}

/// The feature of a number of steps.
fn distance(cost: f32) -> f32 {
    0.4 * ln(1.0 + cost)
}

fn logit(probability: f32) -> f32 {
    let probability = probability.clamp(0.001, 0.999);
    ln(probability / (1.0 - probability))
}

/// The natural logarithm of a positive number, within 3e-5: a polynomial of the fraction, fitted to 1..2, and the exponent. Faster than
/// that of the system's library, and the same bits on every processor.
fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let fraction = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    let polynomial = 0.030_102_63;
    let polynomial = polynomial * fraction - 0.280_632_54;
    let polynomial = polynomial * fraction + 1.104_808_2;
    let polynomial = polynomial * fraction - 2.420_812_6;
    let polynomial = polynomial * fraction + 3.498_228;
    let polynomial = polynomial * fraction - 1.931_671_5;
    polynomial + exponent as f32 * std::f32::consts::LN_2
}

/// What was chosen for a cell.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Chosen {
    /// Inverse depth, 1/m; 0: there was no candidate.
    pub inverse_depth: f32,
    /// Probability that it is right.
    pub probability: f32,
}

/// Chooses for all cells of a frame; keeps its buffers from frame to frame.
#[derive(Debug, Default)]
pub(super) struct Choice {
    /// The candidates of every cell.
    candidates: Vec<[f32; CANDIDATES]>,
    /// For every row of cells, a line for each feature.
    features: Vec<f32>,
    /// For every row of cells, a line for each averaged feature: its sum along the row.
    sums: Vec<f32>,
    /// For every row of cells, a line for each neuron.
    neurons: Vec<f32>,
    chosen: Vec<Chosen>,
}

impl Choice {
    /// Chooses for `count` cells, rows of `width`.
    pub fn update(
        &mut self,
        count: usize,
        width: usize,
        cell: impl Fn(usize) -> Cell + Sync,
    ) -> &[Chosen] {
        let height = count / width;
        self.candidates.resize(count, Default::default());
        self.chosen.resize(count, Chosen::default());
        self.features.resize(count * FEATURES, 0.0);
        self.sums.resize(count * AVERAGED.len(), 0.0);
        self.neurons.resize(count * NEURONS, 0.0);
        self.describe(width, cell);
        self.decide(width, height);
        &self.chosen
    }

    /// Writes the candidates and the features of all cells, and the sums of the features that are averaged.
    fn describe(&mut self, width: usize, cell: impl Fn(usize) -> Cell + Sync) {
        let rows = self.features.par_chunks_exact_mut(FEATURES * width);
        let rows = rows.zip(self.sums.par_chunks_exact_mut(AVERAGED.len() * width));
        let rows = rows.zip(self.candidates.par_chunks_exact_mut(width)).enumerate();
        rows.for_each(|(row, ((features, sums), candidates))| {
            for (column, candidates) in candidates.iter_mut().enumerate() {
                let cell = cell(row * width + column);
                *candidates = cell.candidates();
                for (line, value) in features.chunks_exact_mut(width).zip(cell.features()) {
                    line[column] = value;
                }
            }
            for (sums, feature) in sums.chunks_exact_mut(width).zip(AVERAGED) {
                sum_along(&features[feature * width..][..width], sums);
            }
        });
    }

    /// Averages features, runs the network and takes the most probable candidates.
    fn decide(&mut self, width: usize, height: usize) {
        let sums = &self.sums;
        let rows = self.features.par_chunks_exact_mut(FEATURES * width);
        let rows = rows.zip(self.chosen.par_chunks_exact_mut(width));
        let rows = rows.zip(self.neurons.par_chunks_exact_mut(NEURONS * width));
        let rows = rows.zip(self.candidates.par_chunks_exact(width)).enumerate();
        rows.for_each(|(row, (((features, chosen), neurons), candidates))| {
            average(sums, row, height, &mut features[OWN * width..]);
            let logits = run(features, neurons, width);
            for (column, (chosen, candidates)) in chosen.iter_mut().zip(candidates).enumerate() {
                let logits = std::array::from_fn(|index| logits[index * width + column]);
                *chosen = best(candidates, &logits);
            }
        });
    }

    /// The candidates of every cell of the last [`update`](Self::update).
    pub fn candidates(&self) -> &[[f32; CANDIDATES]] {
        &self.candidates
    }

    /// The result of the last [`update`](Self::update).
    #[cfg(test)]
    pub fn chosen(&self) -> &[Chosen] {
        &self.chosen
    }

    /// The inputs of the network for one cell of rows of `width` cells.
    pub fn features(&self, cell: usize, width: usize) -> [f32; FEATURES] {
        let row = &self.features[cell / width * FEATURES * width..];
        std::array::from_fn(|feature| row[feature * width + cell % width])
    }
}

/// The most probable candidate, or a more precise one that agrees with it.
fn best(candidates: &[f32; CANDIDATES], logits: &[f32; CANDIDATES]) -> Chosen {
    let mut chosen = Chosen::default();
    let mut best = f32::NEG_INFINITY;
    for (inverse_depth, logit) in candidates.iter().zip(logits) {
        if *inverse_depth > 0.0 && *logit > best {
            best = *logit;
            chosen.inverse_depth = *inverse_depth;
        }
    }
    // Right within 25 % is enough for the network, but not for a map: the scan measures to a centimetre, and coarse depth of this frame is
    // of this cell, unlike what was recalled or filled.
    let [coarse, _, _, wall] = *candidates;
    for precise in [coarse, wall] {
        if precise > 0.0 && agree(precise, chosen.inverse_depth) {
            chosen.inverse_depth = precise;
        }
    }
    let is_known = chosen.inverse_depth > 0.0;
    chosen.probability = if is_known { 1.0 / (1.0 + (-best).exp()) } else { 0.0 };
    chosen
}

/// Sums of the cells up to [`REACH`] to each side.
#[multiversion(targets("x86_64+avx2"))]
fn sum_along(line: &[f32], sums: &mut [f32]) {
    let width = line.len();
    // Columns from `first` to `end` have all their neighbours: these sums need no limits, and use the processor's vectors.
    let first = REACH.min(width);
    let end = width.saturating_sub(REACH).max(first);
    sums.fill(0.0);
    for step in 0..=2 * REACH {
        for (sum, value) in sums[first..end].iter_mut().zip(&line[step.min(width)..]) {
            *sum += value;
        }
        for column in (0..first).chain(end..width) {
            sums[column] += line[(column + step).saturating_sub(REACH).min(width - 1)];
        }
    }
}

/// Averages the sums of the rows up to [`REACH`] above and below `row`.
#[multiversion(targets("x86_64+avx2"))]
fn average(sums: &[f32], row: usize, height: usize, averages: &mut [f32]) {
    averages.fill(0.0);
    for at in row..=row + 2 * REACH {
        let row = at.saturating_sub(REACH).min(height - 1);
        let sums = &sums[row * averages.len()..][..averages.len()];
        for (average, sum) in averages.iter_mut().zip(sums) {
            *average += sum;
        }
    }
    let cells = ((2 * REACH + 1) * (2 * REACH + 1)) as f32;
    averages.iter_mut().for_each(|average| *average /= cells);
}

/// Runs the network for a row of cells, and returns a line of logits for each candidate.
fn run<'a>(features: &[f32], neurons: &'a mut [f32], width: usize) -> &'a [f32] {
    let (first, others) = neurons.split_at_mut(HIDDEN * width);
    let (second, logits) = others.split_at_mut(HIDDEN * width);
    layer(features, &WEIGHTS_1, &BIASES_1, width, first);
    rectify(first);
    layer(first, &WEIGHTS_2, &BIASES_2, width, second);
    rectify(second);
    layer(second, &WEIGHTS_3, &BIASES_3, width, logits);
    logits
}

#[multiversion(targets("x86_64+avx2"))]
fn layer<const N: usize>(
    inputs: &[f32],
    weights: &[[f32; N]],
    biases: &[f32],
    width: usize,
    outputs: &mut [f32],
) {
    let outputs = outputs.chunks_exact_mut(width);
    for ((output, weights), bias) in outputs.zip(weights).zip(biases) {
        output.fill(*bias);
        for (input, weight) in inputs.chunks_exact(width).zip(weights) {
            for (output, input) in output.iter_mut().zip(input) {
                *output += weight * input;
            }
        }
    }
}

fn rectify(values: &mut [f32]) {
    values.iter_mut().for_each(|value| *value = value.max(0.0));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WIDTH: usize = 20;
    const HEIGHT: usize = 12;

    fn seen(inverse_depth: f32, probability: f32) -> (Belief, Surround, f32) {
        let belief = Belief { inverse_depth, evidence: 3.0, votes: 4.0, offset: [0.0; 2] };
        (belief, Surround { confidence: 0.7, agreeing: 1.0 }, probability)
    }

    fn wall(inverse_depth: f32, share: f32) -> (Wall, f32) {
        (Wall { inverse_depth, is_floor: false }, share)
    }

    fn filled(inverse_depth: f32, cost: f32) -> Filled {
        Filled { inverse_depth, cost, spread: 0.1 }
    }

    fn choose(cell: impl Fn(usize) -> Cell + Sync) -> Choice {
        let mut choice = Choice::default();
        choice.update(WIDTH * HEIGHT, WIDTH, cell);
        choice
    }

    /// Cells in which everything differs from cell to cell.
    fn varied(index: usize) -> Cell {
        let at = |step: usize| (index * step % 17) as f32 / 17.0;
        Cell {
            coarse: seen(0.2 + at(3), if index.is_multiple_of(3) { 0.0 } else { at(5) }),
            vote: index.is_multiple_of(2).then(|| Vote {
                inverse_depth: 0.3 + at(7),
                margin: at(2),
                texture: at(4),
                misfit: at(6),
                parallax_px: 8.0 * at(8),
            }),
            recalled: seen(0.3 + at(11), at(9)),
            filled: filled(0.3 + at(10), 20.0 * at(12)),
            sides: [Carried { inverse_depth: at(13), cost: 9.0 * at(14) }; 4],
            wall: wall(if index.is_multiple_of(5) { 0.0 } else { 0.5 }, at(15)),
        }
    }

    /// The network for one cell in double precision, the averages computed one by one.
    fn expected(choice: &Choice, cell: usize) -> [f64; CANDIDATES] {
        let mut inputs = choice.features(cell, WIDTH).map(f64::from);
        let (row, column) = ((cell / WIDTH) as isize, (cell % WIDTH) as isize);
        let reach = REACH as isize;
        for (average, feature) in inputs[OWN..].iter_mut().zip(AVERAGED) {
            let mut sum = 0.0;
            for y in row - reach..=row + reach {
                for x in column - reach..=column + reach {
                    let row = y.clamp(0, HEIGHT as isize - 1) as usize;
                    let column = x.clamp(0, WIDTH as isize - 1) as usize;
                    sum += f64::from(choice.features(row * WIDTH + column, WIDTH)[feature]);
                }
            }
            *average = sum / 289.0;
        }
        let first = neurons(&inputs, &WEIGHTS_1, &BIASES_1).map(|value| value.max(0.0));
        let second = neurons(&first, &WEIGHTS_2, &BIASES_2).map(|value| value.max(0.0));
        neurons(&second, &WEIGHTS_3, &BIASES_3)
    }

    fn neurons<const I: usize, const O: usize>(
        inputs: &[f64; I],
        weights: &[[f32; I]; O],
        biases: &[f32; O],
    ) -> [f64; O] {
        std::array::from_fn(|output| {
            let products = inputs.iter().zip(&weights[output]).map(|(a, b)| a * f64::from(*b));
            f64::from(biases[output]) + products.sum::<f64>()
        })
    }

    #[test]
    fn every_cell_has_the_candidate_of_the_highest_logit_that_exists_and_its_probability() {
        let choice = choose(varied);
        for (cell, chosen) in choice.chosen().iter().enumerate() {
            let logits = expected(&choice, cell);
            let candidates = choice.candidates()[cell];
            let best = (0..CANDIDATES)
                .filter(|index| candidates[*index] > 0.0)
                .max_by(|a, b| logits[*a].total_cmp(&logits[*b]))
                .unwrap();
            let [coarse, _, _, wall] = candidates;
            let mut depth = candidates[best];
            if coarse > 0.0 && agree(coarse, depth) {
                depth = coarse;
            }
            if wall > 0.0 && agree(wall, depth) {
                depth = wall;
            }
            assert_eq!(chosen.inverse_depth, depth, "cell {cell}");
            let probability = 1.0 / (1.0 + (-logits[best]).exp());
            assert!((f64::from(chosen.probability) - probability).abs() < 1e-4, "cell {cell}");
        }
    }

    #[test]
    fn a_wall_that_agrees_with_what_was_seen_gives_its_more_precise_depth() {
        let choice = choose(|_| Cell {
            coarse: seen(0.5, 0.95),
            recalled: seen(0.5, 0.95),
            filled: filled(0.5, 0.0),
            wall: wall(0.53, 0.5),
            ..Cell::default()
        });
        assert!(choice.chosen().iter().all(|chosen| chosen.inverse_depth == 0.53));
    }

    #[test]
    fn a_cell_without_candidates_has_no_depth_and_no_probability() {
        let choice = choose(|_| Cell::default());
        assert!(choice.chosen().iter().all(|chosen| *chosen == Chosen::default()));
    }

    #[test]
    fn a_blank_wall_is_that_of_the_scan_although_coarse_depth_is_there() {
        // Coarse depth of a few cells, among neighbours that contradict it; where there was more to see, the walls agreed.
        let choice = choose(|_| {
            let (belief, _, probability) = seen(0.25, 0.4);
            Cell {
                coarse: (belief, Surround { confidence: 0.3, agreeing: 0.25 }, probability),
                filled: filled(0.45, 15.0),
                sides: [Carried { inverse_depth: 0.45, cost: 15.0 }; 4],
                wall: wall(0.5, 0.9),
                ..Cell::default()
            }
        });
        assert!(choice.chosen().iter().all(|chosen| chosen.inverse_depth == 0.5));
    }

    #[test]
    fn what_was_seen_before_a_wall_stays_before_it() {
        let choice = choose(|_| Cell {
            coarse: seen(0.8, 0.95),
            recalled: seen(0.8, 0.95),
            filled: filled(0.8, 0.0),
            sides: [Carried { inverse_depth: 0.8, cost: 0.0 }; 4],
            wall: wall(0.4, 0.2),
            vote: Some(Vote {
                inverse_depth: 0.8,
                margin: 0.6,
                texture: 0.3,
                misfit: 0.2,
                parallax_px: 20.0,
            }),
        });
        assert!(choice.chosen().iter().all(|chosen| chosen.inverse_depth == 0.8));
        assert!(choice.chosen().iter().all(|chosen| chosen.probability > 0.9));
    }

    #[test]
    fn the_result_does_not_depend_on_the_number_of_threads() {
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let three = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let [one, three] = [one, three].map(|pool| pool.install(|| choose(varied)));
        assert_eq!(one.chosen(), three.chosen());
    }

    proptest! {
        #[test]
        fn the_logarithm_is_that_of_the_library(x in 1e-6_f32..1e6) {
            prop_assert!((ln(x) - x.ln()).abs() < 4e-5);
        }
    }
}
