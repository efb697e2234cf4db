//! Depth between the hypotheses: brightness says how far a match is from where whole pixels put it.
//!
//! One Gauss-Newton step along the epipolar lines (Lucas and Kanade 1981) for every cell. Descriptors are looked up at whole
//! pixels, which is half a pixel too coarse: 5 % of the depth at ten pixels of parallax. A gain and an offset are free, so
//! exposure does not matter.

use multiversion::multiversion;

use super::census::CensusImage;
use super::sweep::{CELL, Look, Reference, nearest};
use super::winner::Vote;

/// Samples of a patch along each side, and full-size pixels between them: 8x8 pixels.
const SIDE: usize = 4;
const STEP: usize = 2;
const SAMPLES: usize = SIDE * SIDE;
/// From a cell's first position to the patch's first sample.
const LEAD: usize = 2;
/// Full-size pixels from the first sample to the last, and to the middle.
const SPAN: usize = (SIDE - 1) * STEP;
const MIDDLE: f32 = SPAN as f32 / 2.0;
/// A match moves by less than this, pixels: whole pixels and planes are not wrong by more.
const REACH_PX: f32 = 1.0;
/// (Sensor noise / expected correction)^2: (2 grey levels / 0.4 px)^2. Where the picture is flat, nothing moves.
const PRIOR: f32 = 25.0;
/// Variance that noise alone gives a patch, grey levels squared.
const NOISE: f32 = 4.0;

/// The patch of a cell: brightness and its slopes, grey levels (per pixel).
struct Patch {
    value: [f32; SAMPLES],
    slope_u: [f32; SAMPLES],
    slope_v: [f32; SAMPLES],
}

/// Moves the votes of a row of cells and measures their misfit. `picture` and the references have the same size.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn polish<'a>(
    picture: &CensusImage,
    references: &[Option<Reference<'a>>],
    row: usize,
    farthest: f32,
    votes: &mut [Vote],
) {
    for (column, vote) in votes.iter_mut().enumerate().filter(|(_, vote)| vote.parallax_px > 0.0) {
        let (patch, u, v) = patch(picture, CELL * column, CELL * row);
        let Some((census, look)) = fastest(references, u, v, vote.inverse_depth) else {
            vote.misfit = 1.0;
            continue;
        };
        let step =
            step(&patch, &seen(census, &look), look.motion.map(|motion| motion / look.speed));
        let change_px = step.pull / (step.hold + PRIOR);
        if change_px.abs() < REACH_PX {
            vote.inverse_depth = (vote.inverse_depth + change_px / look.speed).max(farthest);
        }
        vote.misfit = step.misfit;
    }
}

/// Of the references that see the whole patch the one in which it moves the most with its depth: that one tells it best.
#[inline(always)]
fn fastest<'a>(
    references: &[Option<Reference<'a>>],
    u: f32,
    v: f32,
    w: f32,
) -> Option<(&'a CensusImage, Look)> {
    let (mut best, mut squared_speed) = (None, 0.0);
    // The last reference is the farthest away, most often the fastest.
    for reference in references.iter().rev().flatten() {
        let Some(glance) = reference.glance(u, v, w) else { continue };
        if glance.squared_speed > squared_speed {
            let look = reference.look(glance);
            if is_visible(reference.census, &look) {
                (best, squared_speed) = (Some((reference.census, look)), glance.squared_speed);
            }
        }
    }
    best
}

/// The patch of the cell that begins at (u, v), and where its middle is. At the edge of the picture it is moved inwards.
#[inline(always)]
fn patch(picture: &CensusImage, u: usize, v: usize) -> (Patch, f32, f32) {
    let first = |at: usize, size: usize| at.saturating_sub(LEAD).clamp(1, size - SPAN - 2);
    let (u, v) = (first(u, picture.width), first(v, picture.height));
    let mut pairs = [[0_u32; SAMPLES]; 4];
    for row in 0..SIDE {
        // Every sample and the one to its left; the two to its right; above; below.
        let line = |offset: usize| {
            let first = (v - 1 + row * STEP) * picture.width + u - 1 + offset;
            picture.smooth.get(first..first + SIDE * STEP).unwrap_or(&[0; SIDE * STEP])
        };
        let lines =
            [line(picture.width), line(picture.width + STEP), line(0), line(2 * picture.width)];
        for (pairs, line) in pairs.iter_mut().zip(lines) {
            for (pair, two) in pairs[row * SIDE..].iter_mut().zip(line.chunks_exact(STEP)) {
                *pair = joined(two[0], two[1]);
            }
        }
    }
    let mut patch =
        Patch { value: [0.0; SAMPLES], slope_u: [0.0; SAMPLES], slope_v: [0.0; SAMPLES] };
    for index in 0..SAMPLES {
        let [here, right, above, below] = pairs.each_ref().map(|pairs| pairs[index]);
        patch.value[index] = second(here);
        patch.slope_u[index] = 0.5 * (first_of(right) - first_of(here));
        patch.slope_v[index] = 0.5 * (second(below) - second(above));
    }
    (patch, u as f32 + MIDDLE, v as f32 + MIDDLE)
}

/// Whether the whole patch is inside of the picture.
#[inline(always)]
fn is_visible(census: &CensusImage, look: &Look) -> bool {
    let inside = |axis: usize, size: usize| {
        let reach = MIDDLE * (look.along_u[axis].abs() + look.along_v[axis].abs());
        look.place[axis] > reach && look.place[axis] + reach + 2.0 < size as f32
    };
    inside(0, census.width) && inside(1, census.height)
}

/// What the picture shows where the patch should be, bilinear.
#[inline(always)]
fn seen(census: &CensusImage, look: &Look) -> [f32; SAMPLES] {
    let Look { place, along_u, along_v, .. } = look;
    let (mut right, mut below, mut first) = ([0.0; SAMPLES], [0.0; SAMPLES], [0_u32; SAMPLES]);
    for index in 0..SAMPLES {
        let du = (index % SIDE * STEP) as f32 - MIDDLE;
        let dv = (index / SIDE * STEP) as f32 - MIDDLE;
        let x = place[0] + along_u[0] * du + along_v[0] * dv;
        let y = place[1] + along_u[1] * du + along_v[1] * dv;
        let (left, top) = (nearest(x - 0.5), nearest(y - 0.5));
        (right[index], below[index]) = (x - left as f32, y - top as f32);
        first[index] = (top as u32).wrapping_mul(census.width as u32).wrapping_add(left as u32);
    }
    let (mut uppers, mut lowers) = ([0_u32; SAMPLES], [0_u32; SAMPLES]);
    for (index, first) in first.iter().enumerate() {
        let pair =
            |at: usize| census.smooth.get(at..at + 2).map_or(0, |pair| joined(pair[0], pair[1]));
        (uppers[index], lowers[index]) =
            (pair(*first as usize), pair(*first as usize + census.width));
    }
    let mut seen = [0.0; SAMPLES];
    for index in 0..SAMPLES {
        let [a, b] = [first_of(uppers[index]), second(uppers[index])];
        let [c, d] = [first_of(lowers[index]), second(lowers[index])];
        let (upper, lower) = (a + (b - a) * right[index], c + (d - c) * right[index]);
        seen[index] = upper + (lower - upper) * below[index];
    }
    seen
}

/// Two neighbours in one word, so that they are loaded and made into numbers side by side.
#[inline(always)]
fn joined(first: u16, second: u16) -> u32 {
    u32::from(first) | u32::from(second) << 16
}

/// The first of two neighbours, grey levels.
#[inline(always)]
fn first_of(pair: u32) -> f32 {
    (pair & 0xffff) as i32 as f32 * (1.0 / 256.0)
}

/// The second.
#[inline(always)]
fn second(pair: u32) -> f32 {
    (pair >> 16) as i32 as f32 * (1.0 / 256.0)
}

/// What one reference says about a cell.
struct Step {
    /// Normal equation of the motion along the line, pixels: `hold` x motion = `pull`.
    pull: f32,
    hold: f32,
    /// Share of what is seen that the patch does not explain, 0 to 1.
    misfit: f32,
}

/// The motion along `direction` that makes `seen` the patch up to gain and offset.
#[inline(always)]
fn step(patch: &Patch, seen: &[f32; SAMPLES], direction: [f32; 2]) -> Step {
    let share = 1.0 / SAMPLES as f32;
    let mut slope = [0.0; SAMPLES];
    for ((slope, u), v) in slope.iter_mut().zip(&patch.slope_u).zip(&patch.slope_v) {
        *slope = u * direction[0] + v * direction[1];
    }
    let (mean_value, mean_seen, mean_slope) =
        (total(&patch.value) * share, total(seen) * share, total(&slope) * share);
    // Products of what differs from the mean: slope, value and seen.
    let (mut values, mut seens) = ([0.0; SAMPLES], [0.0; SAMPLES]);
    for index in 0..SAMPLES {
        slope[index] -= mean_slope;
        values[index] = patch.value[index] - mean_value;
        seens[index] = seen[index] - mean_seen;
    }
    let (ss, sv, vv) = (dot(&slope, &slope), dot(&slope, &values), dot(&values, &values));
    let (es, ev, ee) = (dot(&slope, &seens), dot(&values, &seens), dot(&seens, &seens));
    // seen = gain * (value - motion * slope), solved without the gain first.
    let per_value = 1.0 / (vv + 1.0);
    let (pull, hold) = (sv * ev * per_value - es, ss - sv * sv * per_value);
    let left = ee - ev * ev * per_value - pull * pull / (hold + PRIOR);
    let noise = NOISE * SAMPLES as f32;
    let misfit = ((left + noise) / (ee + noise)).clamp(0.0, 1.0);
    Step { pull, hold: hold * (ev * per_value).clamp(0.5, 2.0), misfit }
}

/// Sums in lanes, as the vector unit does.
#[inline(always)]
fn total(values: &[f32; SAMPLES]) -> f32 {
    let mut lanes = [0.0; SAMPLES / 2];
    let (first, second) = values.split_at(SAMPLES / 2);
    for ((lane, first), second) in lanes.iter_mut().zip(first).zip(second) {
        *lane = first + second;
    }
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[inline(always)]
fn dot(a: &[f32; SAMPLES], b: &[f32; SAMPLES]) -> f32 {
    let mut products = [0.0; SAMPLES];
    for ((product, a), b) in products.iter_mut().zip(a).zip(b) {
        *product = a * b;
    }
    total(&products)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{CameraModel, ImageView, PixelFormat, Pose3};

    /// Focal length 32 px; a metre to the right at inverse depth 0.5 is 16 px.
    const SIZE: usize = 64;
    const FARTHEST: f32 = 0.05;

    fn waves(x: f64, y: f64) -> f64 {
        120.0 + 40.0 * (0.8 * x + 0.3 * y).sin() + 25.0 * (0.7 * y - 0.6 * x + 1.0).cos()
    }

    fn image(grey: impl Fn(f64, f64) -> f64) -> CensusImage {
        let data: Vec<u8> =
            (0..SIZE * SIZE).map(|i| grey((i % SIZE) as f64, (i / SIZE) as f64) as u8).collect();
        let mut image = CensusImage::default();
        assert!(image.compute(ImageView::new(SIZE, SIZE, PixelFormat::Gray8, &data).unwrap()));
        image
    }

    /// The votes of the row in the middle after a look at `reference` from 0.5 m to the right.
    fn polished(picture: &CensusImage, reference: &CensusImage, inverse_depth: f32) -> Vec<Vote> {
        let camera = CameraModel::pinhole(SIZE, SIZE, std::f64::consts::FRAC_PI_2);
        let camera = camera.cropped(0.5, 0.5, SIZE, SIZE);
        let reference = Reference::new(reference, &Pose3::translation(-0.5, 0.0, 0.0), &camera);
        let mut votes =
            vec![Vote { inverse_depth, parallax_px: 8.0, ..Vote::default() }; SIZE / CELL];
        polish(picture, &[None, Some(reference)], SIZE / CELL / 2, FARTHEST, &mut votes);
        votes.drain(..3);
        votes.truncate(10);
        votes
    }

    #[test]
    fn a_match_half_a_pixel_off_is_moved_to_its_place_whatever_the_exposure() {
        // 8 px at inverse depth 0.5; 8.5 px are 0.53125.
        let picture = image(waves);
        for (gain, offset) in [(1.0, 0.0), (1.3, 10.0), (0.7, -5.0)] {
            let reference = image(|x, y| gain * waves(x + 8.0, y) + offset);
            for vote in polished(&picture, &reference, 0.531_25) {
                assert!((vote.inverse_depth - 0.5).abs() < 0.1 / 16.0, "{}", vote.inverse_depth);
                assert!(vote.misfit < 0.05, "{}", vote.misfit);
            }
        }
    }

    #[test]
    fn where_the_picture_is_flat_nothing_moves_and_nothing_is_confirmed() {
        let flat = image(|x, _| 77.0 + x % 2.0);
        for vote in polished(&flat, &flat, 0.5) {
            assert!((vote.inverse_depth - 0.5).abs() < 1e-3 && vote.misfit > 0.8, "{vote:?}");
        }
    }

    #[test]
    fn another_thing_does_not_fit() {
        let other = image(|x, y| 120.0 + 50.0 * (0.7 * y - 0.5 * x).sin());
        let misfit: f32 =
            polished(&image(waves), &other, 0.5).iter().map(|vote| vote.misfit).sum::<f32>() / 10.0;
        assert!(misfit > 0.5, "{misfit}");
    }

    #[test]
    fn what_nobody_sees_is_not_moved_and_not_confirmed() {
        // A parallax of 64 px leaves the picture.
        let picture = image(waves);
        for vote in polished(&picture, &picture, 4.0) {
            assert_eq!((vote.inverse_depth, vote.misfit), (4.0, 1.0));
        }
    }
}
