//! The camera's height above the floor, from points of the floor.
//!
//! The motion between two frames is known in metres, so every followed point has a distance. A point at the ray `r` (z = 1) that
//! points down by `d` per metre of depth lies on the floor at the inverse depth `d / height`. Points of other things below the
//! horizon stand above the floor and are outliers of the fit.

use nalgebra::DVector;

use super::least_squares::{Block, Estimate, Model, Prior, fit, robust_sigma};

/// A followed point below the horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LowPoint {
    pub time_s: f64,
    /// Metres down per metre of depth.
    pub down: f64,
    /// Inverse depth by its motion, 1/m, and the standard deviation of that.
    pub inverse_m: f64,
    pub sigma: f64,
}

/// A point counts while it is this near to the floor of the configured height, as a share of it.
const NEAR: f64 = 0.3;
/// A depth that is less certain than this share says little.
const LARGEST_SIGMA: f64 = 0.1;
/// Rays that go down less than this meet the floor too far away: an error of the pitch counts too much.
pub(super) const LEAST_DOWN: f64 = 0.12;
/// Share of the points that noise alone puts below the floor, at least: half of those of the floor, which are assumed to be a third of all.
const LEAST_BELOW: f64 = 0.15;
const BLOCK_S: f64 = 4.0;
/// With fewer points there is no floor to be seen.
const LEAST_POINTS: usize = 100;

/// Points near the floor. The parameter is the inverse height.
struct FloorPoints {
    points: Vec<LowPoint>,
}

impl FloorPoints {
    fn residual(point: &LowPoint, inverse_height: f64) -> f64 {
        point.down * inverse_height - point.inverse_m
    }
}

impl FloorPoints {
    /// How many times larger residuals are than their standard deviations. Nothing is below the floor, so that the points there
    /// show the noise alone; while few are there, the height is not found yet.
    fn scale(&self, inverse_height: f64) -> f64 {
        let normalised = |point: &LowPoint| Self::residual(point, inverse_height) / point.sigma;
        let mut all: Vec<f64> = self.points.iter().map(normalised).collect();
        let mut below: Vec<f64> = all.iter().copied().filter(|residual| *residual > 0.0).collect();
        let is_found = LEAST_BELOW * all.len() as f64 <= below.len() as f64;
        robust_sigma(if is_found { &mut below } else { &mut all }).unwrap_or(1.0).max(1.0)
    }
}

impl Model for FloorPoints {
    fn linearise(&mut self, parameters: &DVector<f64>) -> Vec<Block> {
        let scale = self.scale(parameters[0]);
        let last_s = self.points.iter().fold(0.0, |last: f64, point| last.max(point.time_s));
        let mut blocks = vec![Block::empty(1); (last_s / BLOCK_S) as usize + 1];
        for point in &self.points {
            let jacobian = DVector::from_element(1, point.down);
            let residual = Self::residual(point, parameters[0]);
            let block = &mut blocks[(point.time_s.max(0.0) / BLOCK_S) as usize];
            block.add(&jacobian, residual, scale * point.sigma);
        }
        blocks
    }
}

/// The height with its standard deviation, metres. `None` without floor.
///
/// Points near the robot and points far from it are one floor only if they agree: what they differ by counts as uncertainty.
pub(super) fn height(points: &[LowPoint], configured_m: f64) -> Option<[f64; 2]> {
    let mut points: Vec<LowPoint> =
        points.iter().filter(|point| is_near(point, configured_m)).copied().collect();
    let [height_m, sigma_m] = fit_height(&points, configured_m)?;
    points.sort_by(|a, b| a.down.total_cmp(&b.down));
    let (far, near) = points.split_at(points.len() / 2);
    let [far_m, _] = fit_height(far, configured_m)?;
    let [near_m, _] = fit_height(near, configured_m)?;
    Some([height_m, sigma_m.hypot(far_m - near_m)])
}

fn is_near(point: &LowPoint, configured_m: f64) -> bool {
    let expected = point.down / configured_m;
    point.down >= LEAST_DOWN
        && (point.inverse_m / expected - 1.0).abs() < NEAR
        && point.sigma < LARGEST_SIGMA * expected
}

fn fit_height(points: &[LowPoint], configured_m: f64) -> Option<[f64; 2]> {
    if points.len() < LEAST_POINTS {
        return None;
    }
    let points = points.to_vec();
    let mean = DVector::from_element(1, 1.0 / configured_m);
    let prior = Prior { mean: mean.clone(), sigma: NEAR * &mean };
    let found: Estimate = fit(&mut FloorPoints { points }, &prior, &mean)?;
    let height_m = 1.0 / found.parameters[0];
    Some([height_m, found.sigma(0) * height_m * height_m])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// Points of a floor 0.83 m below the camera, and `things` of a height of 10 to 50 cm among them.
    fn points(things: usize) -> Vec<LowPoint> {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        (0..600)
            .map(|index: usize| {
                let above_m = if index < things { rng.random_range(0.1..0.5) } else { 0.0 };
                let down = rng.random_range(0.15..0.3);
                let noise = 0.01 * (rng.random::<f64>() + rng.random::<f64>() - 1.0);
                LowPoint {
                    time_s: 0.1 * index as f64,
                    down,
                    inverse_m: down / (0.83 - above_m) + noise,
                    sigma: 0.005,
                }
            })
            .collect()
    }

    #[test]
    fn the_height_is_that_above_the_floor_and_not_above_things_on_it() {
        for configured_m in [0.75, 0.8, 0.86, 0.9] {
            for things in [0, 150, 300] {
                let [height_m, sigma_m] = height(&points(things), configured_m).unwrap();
                assert!((height_m - 0.83).abs() < 0.005, "{height_m} from {configured_m}");
                assert!(sigma_m < 0.015, "{sigma_m}");
            }
        }
    }

    #[test]
    fn without_floor_there_is_no_height() {
        assert_eq!(height(&points(590), 0.8), None);
    }
}
