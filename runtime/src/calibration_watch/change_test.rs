//! Whether parameters have changed: a test over the last blocks of a drive against what was learnt before.
//!
//! A window-limited generalized likelihood ratio test (Lai 1995, "Sequential changepoint detection in quality control and dynamical
//! systems"): for each block of the window it is asked how well a change at its beginning explains everything since. The beginning that
//! explains most is where the change happened.
//!
//! What was learnt before is the beginning of the run. It is not updated later, so that a change that comes slowly is found as well as
//! one that comes at once. An absolute error that was there from the beginning is never a change.

use std::collections::VecDeque;

use nalgebra::SVector;
use serde::{Deserialize, Serialize};

use super::sums::Sums;

/// Number of blocks among which a change may have begun: with the rotations of a drive through rooms they are more than 10 m, so that
/// a change that is still to be noticed does not count as noise or as the beginning of the run.
const WINDOW: usize = 40;
/// A change is only believed from this many blocks: one block may be a sill, a carpet's edge or a person.
const LEAST_BLOCKS: usize = 3;
/// With fewer blocks the beginning of the run is not known yet.
const LEAST_REFERENCE: u32 = 16;
/// The beginning of the run has this many blocks.
const FULL_REFERENCE: u32 = 60;
/// Equations that pull harder than this many standard deviations pull only so much: slip, people, wrong matches.
const CLIP: f64 = 3.0;
/// Equations are judged beside the estimate of this many blocks.
const CENTER: usize = 4;
/// The noise that is expected before it is measured has the weight of this many blocks.
const NOISE_PRIOR: f64 = 4.0;
/// Measured in fewer blocks than this, the noise is at least the stated one: so a base that is worse than expected raises no alarm.
const LEAST_NOISE_BLOCKS: f64 = 16.0;
/// Of what came between the beginning of the run and the window, this share remains with the next block.
const MIDDLE_MEMORY: f64 = 0.95;
/// Equations with less information than this many times that of the expected value say little of a parameter. Our own choice.
const LEAST_SAID: f64 = 3.0;
/// A change of which this share was there before it seems to begin has come slowly.
const SLOW_SHARE: f64 = 0.3;

/// What is known of the parameters before a drive, and which changes matter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Limits<const N: usize> {
    /// Standard deviations of the parameters and of their changes.
    pub expected: [f64; N],
    /// Noise of the equations, as a share of the stated one, before it is measured.
    pub noise: [f64; N],
    /// Least noise, as a share of the stated one, whatever was measured from block to block.
    pub least_noise: [f64; N],
    /// Smaller changes are not reported.
    pub least: [f64; N],
    /// A change is reported when it is larger than this many of its standard deviations.
    pub sigmas: f64,
}

/// How a parameter has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Manner {
    /// At once: something was hit, exchanged or came loose.
    AtOnce,
    /// Little by little: wear, air pressure, temperature.
    Slowly,
}

/// Where a block of the drive began.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Begin {
    pub driven_m: f64,
    pub time_ns: u64,
}

/// A change that the test has found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Found {
    /// Index of the parameter in the vector that is tested.
    pub index: usize,
    pub by: f64,
    pub sigma: f64,
    pub begin: Begin,
    pub manner: Manner,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Block<const N: usize> {
    sums: Sums<N>,
    begin: Begin,
}

/// The test of `N` parameters that share equations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ChangeTest<const N: usize> {
    /// The beginning of the run, or everything since the last change.
    reference: Sums<N>,
    reference_blocks: u32,
    /// What came after the reference and before the window, fading.
    middle: Sums<N>,
    window: VecDeque<Block<N>>,
    current: Sums<N>,
    /// Equations are judged beside these values.
    center: SVector<f64, N>,
    /// Squares of the blocks' pulls, and what they would be with the stated noise.
    squares: SVector<f64, N>,
    stated: SVector<f64, N>,
    noise_blocks: f64,
}

impl<const N: usize> Default for ChangeTest<N> {
    fn default() -> Self {
        Self {
            reference: Sums::default(),
            reference_blocks: 0,
            middle: Sums::default(),
            window: VecDeque::with_capacity(WINDOW + 1),
            current: Sums::default(),
            center: SVector::zeros(),
            squares: SVector::zeros(),
            stated: SVector::zeros(),
            noise_blocks: 0.0,
        }
    }
}

impl<const N: usize> ChangeTest<N> {
    /// Adds equations to the current block.
    pub(crate) fn add(&mut self, equations: &Sums<N>, limits: &Limits<N>) {
        let mut pull = equations.pull_from(&self.center);
        for index in 0..N {
            let most = CLIP
                * self.likely_noise(index, limits)
                * equations.information[(index, index)].sqrt();
            pull[index] = pull[index].clamp(-most, most);
        }
        let clipped = pull + equations.information * self.center;
        if clipped.iter().all(|value| value.is_finite()) {
            self.current.add(&Sums { pull: clipped, ..*equations });
        }
    }

    /// Ends the current block, which began at `begin`.
    pub(crate) fn end_block(&mut self, begin: Begin, limits: &Limits<N>) {
        let sums = std::mem::take(&mut self.current);
        self.window.push_back(Block { sums, begin });
        if self.window.len() > WINDOW
            && let Some(old) = self.window.pop_front()
        {
            self.learn(&old.sums, limits);
        }
        let mut newest = Sums::default();
        self.window.iter().rev().take(CENTER).for_each(|block| newest.add(&block.sums));
        // Before the beginning of the run is known, the newest blocks are the best guess: after a restart the reference is empty,
        // and beside zero the equations of a robot with unequal wheels would pull too hard.
        let is_known = self.reference_blocks >= LEAST_REFERENCE;
        let base = if is_known { self.reference_estimate(limits) } else { self.center };
        let change = newest.beside(&base).solve(&SVector::from(limits.expected));
        self.center = base + change.map_or_else(SVector::zeros, |(change, _)| change);
    }

    /// A block leaves the window.
    fn learn(&mut self, old: &Sums<N>, limits: &Limits<N>) {
        let mut around = self.middle;
        around.add(old);
        around.add(&self.reference);
        let expected = SVector::from(limits.expected);
        if let Some((estimate, _)) = around.solve(&expected) {
            self.squares += old.pull_from(&estimate).map(|pull| pull * pull);
            self.stated += old.information.diagonal();
            // A block without equations, as without a camera, says nothing of the noise.
            if old.information.trace() > 0.0 {
                self.noise_blocks += 1.0;
            }
        }
        if self.reference_blocks < FULL_REFERENCE {
            self.reference.add(old);
            self.reference_blocks += 1;
        } else {
            self.middle = self.middle.scaled(MIDDLE_MEMORY);
            self.middle.add(old);
        }
    }

    /// Noise of the equations of a parameter, as a share of the stated one. Until it is measured it is not said to be less.
    fn noise(&self, index: usize, limits: &Limits<N>) -> f64 {
        let likely = self.likely_noise(index, limits);
        if self.noise_blocks < LEAST_NOISE_BLOCKS { likely.max(1.0) } else { likely }
    }

    /// The same from what was expected and what was measured so far.
    fn likely_noise(&self, index: usize, limits: &Limits<N>) -> f64 {
        let measured = self.squares[index] / self.stated[index].max(f64::MIN_POSITIVE);
        let sum = NOISE_PRIOR * limits.noise[index].powi(2) + self.noise_blocks * measured;
        (sum / (NOISE_PRIOR + self.noise_blocks)).sqrt().max(limits.least_noise[index])
    }

    fn reference_estimate(&self, limits: &Limits<N>) -> SVector<f64, N> {
        let solved = self.reference.solve(&SVector::from(limits.expected));
        solved.map_or_else(SVector::zeros, |(estimate, _)| estimate)
    }

    /// The value of a parameter now, over the window, and its standard deviation. It counts from the configured one.
    pub(crate) fn estimate(&self, index: usize, limits: &Limits<N>) -> Option<(f64, f64)> {
        let mut recent = self.current;
        self.window.iter().for_each(|block| recent.add(&block.sums));
        let expected = SVector::from(limits.expected);
        let (parameters, covariance) = recent.solve(&expected)?;
        Some((parameters[index], self.noise(index, limits) * covariance[(index, index)].sqrt()))
    }

    /// Noise of the equations as it was measured so far, as a share of the stated one.
    #[cfg(test)]
    pub(crate) fn noises(&self, limits: &Limits<N>) -> [f64; N] {
        std::array::from_fn(|index| self.noise(index, limits))
    }

    /// Number of blocks in which a change is looked for.
    #[cfg(test)]
    pub(crate) fn blocks(&self) -> usize {
        self.window.len()
    }

    /// The largest change, if there is one.
    pub(crate) fn find(&self, limits: &Limits<N>) -> Option<Found> {
        let found = self.largest(limits, |index, by, sigma| {
            by.abs() >= limits.least[index] && by.abs() > limits.sigmas * sigma
        })?;
        let (begin, index, by, sigma) = found;
        Some(Found { index, by, sigma, begin, manner: self.manner(index, by, begin, limits) })
    }

    /// The parameters at the beginning of the run, or since the last change, and their standard deviations; `None` while they are not
    /// known.
    pub(crate) fn known(&self, limits: &Limits<N>) -> Option<[[f64; N]; 2]> {
        let is_known = self.reference_blocks >= LEAST_REFERENCE;
        is_known.then(|| self.values(&self.reference, limits)).flatten()
    }

    /// The parameters before `begin`, and their standard deviations; `None` if no block of the window began then.
    pub(crate) fn known_before(&self, begin: Begin, limits: &Limits<N>) -> Option<[[f64; N]; 2]> {
        self.values(&self.before(self.first_since(begin)?).0, limits)
    }

    fn values(&self, equations: &Sums<N>, limits: &Limits<N>) -> Option<[[f64; N]; 2]> {
        let (values, covariance) = equations.solve(&SVector::from(limits.expected))?;
        let sigma = |index| self.noise(index, limits) * covariance[(index, index)].sqrt();
        Some([values.into(), std::array::from_fn(sigma)])
    }

    /// Number of blocks since `begin`; `None` if no block of the window began then.
    pub(crate) fn blocks_since(&self, begin: Begin) -> Option<usize> {
        Some(self.window.len() - self.first_since(begin)?)
    }

    fn first_since(&self, begin: Begin) -> Option<usize> {
        self.window.iter().position(|block| block.begin == begin)
    }

    /// Whether the blocks of the window have any equation.
    pub(crate) fn has_equations(&self) -> bool {
        self.window.iter().any(|block| block.sums.information.trace() > 0.0)
    }

    /// The change of a parameter since `begin`, and its standard deviation; `None` if no block of the window began then, if the
    /// beginning of the run is not known yet, or if the blocks since say little beside what was expected.
    pub(crate) fn change_since(
        &self,
        begin: Begin,
        index: usize,
        limits: &Limits<N>,
    ) -> Option<(f64, f64)> {
        let first = self.first_since(begin)?;
        let (before, blocks) = self.before(first);
        let mut since = Sums::default();
        self.window.iter().skip(first).for_each(|block| since.add(&block.sums));
        let expected = limits.expected[index].powi(-2);
        if blocks < LEAST_REFERENCE || since.information[(index, index)] < LEAST_SAID * expected {
            return None;
        }
        let (change, sigma) = self.change(&before, &since, limits)?;
        Some((change[index], sigma[index]))
    }

    /// By how much the parameters after differ from those before, and the standard deviations of that.
    fn change(
        &self,
        before: &Sums<N>,
        after: &Sums<N>,
        limits: &Limits<N>,
    ) -> Option<(SVector<f64, N>, SVector<f64, N>)> {
        let expected = SVector::from(limits.expected);
        let (reference, before) = before.solve(&expected)?;
        let (change, after) = after.beside(&reference).solve(&expected)?;
        let sigma = SVector::from_fn(|index, _| {
            let variance = before[(index, index)] + after[(index, index)];
            self.noise(index, limits) * variance.sqrt()
        });
        Some((change, sigma))
    }

    /// How many standard deviations the largest change of a parameter has.
    pub(crate) fn suspicion(&self, index: usize, limits: &Limits<N>) -> f64 {
        let largest = self.largest(limits, |at, _, _| at == index);
        largest.map_or(0.0, |(_, _, by, sigma)| by.abs() / sigma)
    }

    /// Among the changes that `counts` accepts (index, size, standard deviation), the one with the most standard deviations.
    fn largest(
        &self,
        limits: &Limits<N>,
        counts: impl Fn(usize, f64, f64) -> bool,
    ) -> Option<(Begin, usize, f64, f64)> {
        let mut since = Sums::default();
        let mut best = None;
        let mut most = 0.0;
        for (index, block) in self.window.iter().enumerate().rev() {
            since.add(&block.sums);
            if self.window.len() - index < LEAST_BLOCKS {
                continue;
            }
            let (before, blocks) = self.before(index);
            if blocks < LEAST_REFERENCE {
                break;
            }
            let (change, sigma) = self.change(&before, &since, limits)?;
            for index in 0..N {
                let size = change[index].abs() / sigma[index];
                if size > most && counts(index, change[index], sigma[index]) {
                    most = size;
                    best = Some((block.begin, index, change[index], sigma[index]));
                }
            }
        }
        best
    }

    /// What a change at block `index` of the window is compared with, and how many blocks that is. While the beginning of the run
    /// is not over, the window's earlier blocks belong to it.
    fn before(&self, index: usize) -> (Sums<N>, u32) {
        let mut before = self.reference;
        if self.reference_blocks >= FULL_REFERENCE {
            return (before, self.reference_blocks);
        }
        self.window.iter().take(index).for_each(|block| before.add(&block.sums));
        (before, self.reference_blocks + index as u32)
    }

    /// A change that came at once was not there between the beginning of the run and the beginning of the change.
    fn manner(&self, index: usize, by: f64, begin: Begin, limits: &Limits<N>) -> Manner {
        let reference = self.reference_estimate(limits);
        let mut before = self.middle;
        let earlier = self.window.iter().filter(|block| block.begin.time_ns < begin.time_ns);
        earlier.for_each(|block| before.add(&block.sums));
        let before = before.beside(&reference).solve(&SVector::from(limits.expected));
        let before = before.map_or(0.0, |(change, _)| change[index]);
        if before / by > SLOW_SHARE { Manner::Slowly } else { Manner::AtOnce }
    }

    /// What comes from now on is a new beginning. Blocks around a change are left out: some belong to before it, and what pulled
    /// hard at first counted only so much.
    pub(crate) fn restart(&mut self) {
        self.window.clear();
        self.reference = Sums::default();
        self.reference_blocks = 0;
        self.middle = Sums::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const LIMITS: Limits<1> =
        Limits { expected: [5.0], noise: [1.0], least_noise: [0.05], least: [0.2], sigmas: 6.0 };

    /// Nearly a standard normal number: the sum of twelve uniform ones has a variance of 1.
    fn normal(rng: &mut Pcg64Mcg) -> f64 {
        (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0
    }

    /// The changes that are found, with the block in which they are found. Each block has four equations of the parameter,
    /// with a standard deviation of 1 that is stated as 2.
    fn found(seed: u64, blocks: u64, truth: impl Fn(u64) -> f64) -> Vec<(u64, Found)> {
        found_with(seed, blocks, 4.0, &LIMITS, truth)
    }

    /// The same with another stated variance and other limits.
    fn found_with(
        seed: u64,
        blocks: u64,
        stated: f64,
        limits: &Limits<1>,
        truth: impl Fn(u64) -> f64,
    ) -> Vec<(u64, Found)> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut test = ChangeTest::default();
        let mut all = Vec::new();
        for block in 0..blocks {
            for _ in 0..4 {
                let value = truth(block) + normal(&mut rng);
                test.add(&Sums::of(Vector1::new(1.0), value, stated), limits);
            }
            test.end_block(Begin { driven_m: block as f64, time_ns: block }, limits);
            if let Some(found) = test.find(limits) {
                all.push((block, found));
                test.restart();
            }
        }
        all
    }

    #[test]
    fn a_step_is_found_once_with_its_size_and_its_beginning() {
        for seed in 0..20 {
            let all = found(seed, 200, |block| if block < 100 { 3.0 } else { 5.0 });
            let [(at, step)] = all.as_slice() else { panic!("{seed}: {all:?}") };
            assert!((102..112).contains(at), "{seed}: {at}");
            assert!((step.by - 2.0).abs() < 0.7, "{seed}: {step:?}");
            assert!((step.begin.driven_m - 100.0).abs() <= 3.0, "{seed}: {step:?}");
            assert_eq!(step.manner, Manner::AtOnce, "{seed}");
        }
    }

    #[test]
    fn a_slow_drift_is_found_and_named_so() {
        for seed in 0..20 {
            let all = found(seed, 400, |block| 0.006 * block as f64);
            let (_, first) = all.first().unwrap();
            assert_eq!(first.manner, Manner::Slowly, "{seed}: {first:?}");
        }
    }

    #[test]
    fn an_error_from_the_beginning_on_is_no_change() {
        let falsely: usize = (0..100).map(|seed| found(seed, 500, |_| 4.0).len()).sum();
        assert_eq!(falsely, 0);
    }

    #[test]
    fn one_wild_block_is_no_change() {
        for seed in 0..20 {
            let all = found(seed, 200, |block| if block == 100 { 40.0 } else { 0.0 });
            assert_eq!(all, [], "{seed}");
        }
    }

    #[test]
    fn a_base_that_is_twice_as_noisy_as_expected_raises_no_alarm() {
        let limits = Limits { noise: [0.5], ..LIMITS };
        for seed in 0..100 {
            assert_eq!(found_with(seed, 500, 1.0, &limits, |_| 3.0), [], "{seed}");
        }
    }

    /// The number of changes that are found where every eight blocks have the same error, which is three times as large as stated for
    /// eight blocks with independent errors.
    fn found_with_shared_errors(least_noise: f64) -> usize {
        let limits = Limits { noise: [least_noise], least_noise: [least_noise], ..LIMITS };
        let sigma = 3.0 / 32.0_f64.sqrt();
        (0..50)
            .map(|seed| {
                let mut rng = Pcg64Mcg::seed_from_u64(seed + 1_000);
                let errors: Vec<f64> = (0..60).map(|_| sigma * normal(&mut rng)).collect();
                found_with(seed, 480, 1.0, &limits, |block| errors[block as usize / 8]).len()
            })
            .sum()
    }

    #[test]
    fn errors_that_neighbouring_blocks_share_raise_no_alarm_if_the_least_noise_covers_them() {
        assert_eq!(found_with_shared_errors(3.0), 0);
        let uncovered = found_with_shared_errors(LIMITS.least_noise[0]);
        assert!(uncovered > 10, "{uncovered}");
    }

    /// The number of changes that are found where errors are a sixth of the stated ones, but three blocks of each hundred share an error
    /// that is 1.3 times the stated one of three blocks.
    fn found_with_rare_large_errors(least_noise: f64) -> usize {
        let limits = Limits { least_noise: [least_noise], ..LIMITS };
        let stated = 36.0;
        let rare = 1.3 * (stated / 12.0_f64).sqrt();
        (0..50)
            .map(|seed| {
                found_with(seed + 2_000, 500, stated, &limits, |block| {
                    if block % 100 >= 97 { rare } else { 0.0 }
                })
                .len()
            })
            .sum()
    }

    #[test]
    fn rare_large_errors_raise_no_alarm_if_the_least_noise_covers_them() {
        // 0.5 is an example, as large as these errors need: the limits of the camera are in `calibration_watch`.
        assert_eq!(found_with_rare_large_errors(0.5), 0);
        let uncovered = found_with_rare_large_errors(LIMITS.least_noise[0]);
        assert!(uncovered > 10, "{uncovered}");
    }

    #[test]
    fn blocks_without_equations_say_nothing_of_the_noise() {
        let mut test = ChangeTest::default();
        for block in 0..500 {
            test.end_block(Begin { driven_m: block as f64, time_ns: block }, &LIMITS);
        }
        assert_eq!(test.noises(&LIMITS), LIMITS.noise);
    }

    #[test]
    fn a_change_far_from_the_configured_value_is_no_second_change_after_it() {
        for seed in 0..20 {
            let all = found(seed, 400, |block| if block < 100 { 10.0 } else { 13.0 });
            assert_eq!(all.len(), 1, "{seed}: {all:?}");
        }
    }
}
