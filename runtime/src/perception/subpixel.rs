//! Refines votes to sub-pixel accuracy by comparing brightness.
//!
//! One Gauss-Newton step along the epipolar lines (Lucas and Kanade 1981) for every cell. Descriptors are compared at whole
//! pixels, an error of up to half a pixel: 5 % of the depth at ten pixels of parallax. Gain and offset are estimated too, so
//! exposure does not matter. Votes behind the floor are compared with the floor (`floor_plane.rs`).

use multiversion::multiversion;

use super::census::CensusImage;
use super::floor_plane::FloorPlane;
use super::sweep::{CELL, PatchObservation, Reference, nearest};
use super::wta::Vote;

/// Samples of a patch along each side, and full-size pixels between them: 8x8 pixels.
const SIDE: usize = 4;
const STEP: usize = 2;
const SAMPLES: usize = SIDE * SIDE;
/// Distance from a cell's first position to the patch's first sample, full-size pixels.
const LEAD: usize = 2;
/// Distance from the first sample to the last, and to the middle, full-size pixels.
const SPAN: usize = (SIDE - 1) * STEP;
const MIDDLE: f32 = SPAN as f32 / 2.0;
/// Maximum correction of a match, pixels: rounding to whole pixels and planes is not wrong by more.
const REACH_PX: f32 = 1.0;
/// (Sensor noise / expected correction)^2: (2 grey levels / 0.4 px)^2. Where the image is flat, it keeps the correction at 0.
const PRIOR: f32 = 25.0;
/// Variance of a patch due to sensor noise, grey levels squared.
const NOISE: f32 = 4.0;
/// Inverse depths of the floor that are tried, as shares of that of its plane: pitch and height of the camera are known to some percent,
/// and floors are not quite flat. Half a degree of pitch is 2 % at 2 m.
const FLOOR_TOLERANCE: [f32; 5] = [1.0, 0.96, 1.04, 0.92, 1.08];
/// Share of the brightness pattern that the floor may leave unexplained in addition to what a vote behind it does: the vote has won among
/// all hypotheses.
const FLOOR_ALLOWANCE: f32 = 0.1;

/// The patch of a cell: brightness in grey levels, and its slopes in grey levels per pixel.
struct Patch {
    value: [f32; SAMPLES],
    slope_u: [f32; SAMPLES],
    slope_v: [f32; SAMPLES],
}

/// Corrects the votes of a row of cells and measures their misfit. `image` and the references have the same size. A vote behind the
/// floor is removed where the floor explains the image as well.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn refine_votes<'a>(
    image: &CensusImage,
    references: &[Option<Reference<'a>>],
    row: usize,
    farthest: f32,
    floor: Option<&FloorPlane>,
    votes: &mut [Vote],
) {
    for (column, vote) in votes.iter_mut().enumerate().filter(|(_, vote)| vote.parallax_px > 0.0) {
        let (patch, u, v) = patch(image, CELL * column, CELL * row);
        let Some((census, observed)) = fastest(references, u, v, vote.inverse_depth) else {
            vote.misfit = 1.0;
            continue;
        };
        let step = step_of(&patch, census, &observed);
        let change_px = step.change_px();
        if change_px.abs() < REACH_PX {
            vote.inverse_depth = (vote.inverse_depth + change_px / observed.speed).max(farthest);
        }
        vote.misfit = step.misfit;
        if let Some(floor) = floor
            && floor_explains(floor, [u, v], &patch, references, vote)
        {
            *vote = Vote::default();
        }
    }
}

/// Whether a vote is behind the floor, and the floor explains the patch with the middle (u, v) as well.
#[inline(always)]
fn floor_explains(
    floor: &FloorPlane,
    [u, v]: [f32; 2],
    patch: &Patch,
    references: &[Option<Reference<'_>>],
    vote: &Vote,
) -> bool {
    if !floor.is_before(u, v, vote.inverse_depth) {
        return false;
    }
    for share in FLOOR_TOLERANCE {
        let on_floor = share * floor.inverse_depth(u, v);
        let Some((census, observed)) = fastest(references, u, v, on_floor) else { continue };
        let observed = floor.lay_down(observed);
        if !is_visible(census, &observed) {
            continue;
        }
        let step = step_of(patch, census, &observed);
        let is_near = step.change_px().abs() < REACH_PX;
        if is_near && step.gain > 0.0 && step.misfit <= vote.misfit + FLOOR_ALLOWANCE {
            return true;
        }
    }
    false
}

/// The step of a patch as a reference observes it.
#[inline(always)]
fn step_of(patch: &Patch, census: &CensusImage, observed: &PatchObservation) -> Step {
    let direction = observed.motion.map(|motion| motion / observed.speed);
    step(patch, &warp(census, observed), direction)
}

/// Selects, of the references that see the whole patch, the one in which its position depends most on its depth: it
/// measures depth best.
#[inline(always)]
fn fastest<'a>(
    references: &[Option<Reference<'a>>],
    u: f32,
    v: f32,
    w: f32,
) -> Option<(&'a CensusImage, PatchObservation)> {
    let mut best = None;
    let mut squared_speed = 0.0;
    // The last reference is the farthest away, most often the one with the largest motion.
    for reference in references.iter().rev().flatten() {
        let Some(point) = reference.observe(u, v, w) else { continue };
        if point.squared_speed > squared_speed {
            let patch = reference.observe_patch(point);
            if is_visible(reference.census, &patch) {
                best = Some((reference.census, patch));
                squared_speed = point.squared_speed;
            }
        }
    }
    best
}

/// The patch of the cell that begins at (u, v), and the position of its middle. At the edge of the image it is moved inwards.
#[inline(always)]
fn patch(image: &CensusImage, u: usize, v: usize) -> (Patch, f32, f32) {
    let u = u.saturating_sub(LEAD).clamp(1, image.width - SPAN - 2);
    let v = v.saturating_sub(LEAD).clamp(1, image.height - SPAN - 2);
    let mut pairs = [[0_u32; SAMPLES]; 4];
    for row in 0..SIDE {
        // Each pair holds a sample's left neighbour and itself, its two right neighbours, or the pixels above or below.
        let above = (v - 1 + row * STEP) * image.width + u - 1;
        let offsets = [image.width, image.width + STEP, 0, 2 * image.width];
        for (pairs, offset) in pairs.iter_mut().zip(offsets) {
            let first = above + offset;
            let line = image.smooth.get(first..first + SIDE * STEP).unwrap_or(&[0; SIDE * STEP]);
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

/// Whether the whole patch is inside the image.
#[inline(always)]
fn is_visible(census: &CensusImage, patch: &PatchObservation) -> bool {
    fits(patch, 0, census.width) && fits(patch, 1, census.height)
}

/// Whether the patch lies within `size` pixels along one axis.
#[inline(always)]
fn fits(patch: &PatchObservation, axis: usize, size: usize) -> bool {
    let reach = MIDDLE * (patch.along_u[axis].abs() + patch.along_v[axis].abs());
    patch.position[axis] > reach && patch.position[axis] + reach + 2.0 < size as f32
}

/// The reference's brightness at the patch's samples, bilinear.
#[inline(always)]
fn warp(census: &CensusImage, patch: &PatchObservation) -> [f32; SAMPLES] {
    let PatchObservation { position, along_u, along_v, .. } = patch;
    let mut right = [0.0; SAMPLES];
    let mut below = [0.0; SAMPLES];
    let mut first = [0_u32; SAMPLES];
    for index in 0..SAMPLES {
        let du = (index % SIDE * STEP) as f32 - MIDDLE;
        let dv = (index / SIDE * STEP) as f32 - MIDDLE;
        let x = position[0] + along_u[0] * du + along_v[0] * dv;
        let y = position[1] + along_u[1] * du + along_v[1] * dv;
        let left = nearest(x - 0.5);
        let top = nearest(y - 0.5);
        right[index] = x - left as f32;
        below[index] = y - top as f32;
        first[index] = (top as u32).wrapping_mul(census.width as u32).wrapping_add(left as u32);
    }
    let mut uppers = [0_u32; SAMPLES];
    let mut lowers = [0_u32; SAMPLES];
    for (index, first) in first.iter().enumerate() {
        let at = *first as usize;
        uppers[index] = pair_at(&census.smooth, at);
        lowers[index] = pair_at(&census.smooth, at + census.width);
    }
    let mut seen = [0.0; SAMPLES];
    for index in 0..SAMPLES {
        let [a, b] = [first_of(uppers[index]), second(uppers[index])];
        let [c, d] = [first_of(lowers[index]), second(lowers[index])];
        let upper = a + (b - a) * right[index];
        let lower = c + (d - c) * right[index];
        seen[index] = upper + (lower - upper) * below[index];
    }
    seen
}

/// The pixel at index `at` and the next one; 0 outside.
#[inline(always)]
fn pair_at(smooth: &[u16], at: usize) -> u32 {
    smooth.get(at..at + 2).map_or(0, |pair| joined(pair[0], pair[1]))
}

/// Two neighbours in one word, so that they are loaded and converted together.
#[inline(always)]
fn joined(first: u16, second: u16) -> u32 {
    u32::from(first) | u32::from(second) << 16
}

/// The first of two neighbours, grey levels.
#[inline(always)]
fn first_of(pair: u32) -> f32 {
    (pair & 0xffff) as i32 as f32 * (1.0 / 256.0)
}

/// The second of two neighbours, grey levels.
#[inline(always)]
fn second(pair: u32) -> f32 {
    (pair >> 16) as i32 as f32 * (1.0 / 256.0)
}

/// The Gauss-Newton step of a cell in one reference.
struct Step {
    /// Normal equation of the motion along the line, pixels: `hold` x motion = `pull`.
    pull: f32,
    hold: f32,
    /// Contrast of what is observed as a share of the patch's; negative where bright is dark.
    gain: f32,
    /// Share of the observed variance that the patch does not explain, 0 to 1.
    misfit: f32,
}

impl Step {
    /// The motion along the line, pixels; little where the image is flat.
    #[inline(always)]
    fn change_px(&self) -> f32 {
        self.pull / (self.hold + PRIOR)
    }
}

/// The motion along `direction` after which `seen` equals the patch up to gain and offset.
#[inline(always)]
fn step(patch: &Patch, seen: &[f32; SAMPLES], direction: [f32; 2]) -> Step {
    let share = 1.0 / SAMPLES as f32;
    let mut slope = [0.0; SAMPLES];
    for ((slope, u), v) in slope.iter_mut().zip(&patch.slope_u).zip(&patch.slope_v) {
        *slope = u * direction[0] + v * direction[1];
    }
    let mean_value = total(&patch.value) * share;
    let mean_seen = total(seen) * share;
    let mean_slope = total(&slope) * share;
    // Differences from the mean: slope, value and seen.
    let mut values = [0.0; SAMPLES];
    let mut seens = [0.0; SAMPLES];
    for index in 0..SAMPLES {
        slope[index] -= mean_slope;
        values[index] = patch.value[index] - mean_value;
        seens[index] = seen[index] - mean_seen;
    }
    let ss = dot(&slope, &slope);
    let sv = dot(&slope, &values);
    let vv = dot(&values, &values);
    let es = dot(&slope, &seens);
    let ev = dot(&values, &seens);
    let ee = dot(&seens, &seens);
    // Model: seen = gain * (value - motion * slope), solved with the gain eliminated.
    let per_value = 1.0 / (vv + 1.0);
    let pull = sv * ev * per_value - es;
    let hold = ss - sv * sv * per_value;
    let left = ee - ev * ev * per_value - pull * pull / (hold + PRIOR);
    let noise = NOISE * SAMPLES as f32;
    let misfit = ((left + noise) / (ee + noise)).clamp(0.0, 1.0);
    let gain = ev * per_value;
    Step { pull, hold: hold * gain.clamp(0.5, 2.0), gain, misfit }
}

/// Sums in lanes, in the order of vector registers.
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

    fn census(grey: impl Fn(f64, f64) -> f64) -> CensusImage {
        let data: Vec<u8> =
            (0..SIZE * SIZE).map(|i| grey((i % SIZE) as f64, (i / SIZE) as f64) as u8).collect();
        let mut image = CensusImage::default();
        assert!(image.compute(ImageView::new(SIZE, SIZE, PixelFormat::Gray8, &data).unwrap()));
        image
    }

    /// The refined votes of the middle row, with `reference` seen from 0.5 m to the right.
    fn refined(image: &CensusImage, reference: &CensusImage, inverse_depth: f32) -> Vec<Vote> {
        let camera = CameraModel::pinhole(SIZE, SIZE, std::f64::consts::FRAC_PI_2);
        let camera = camera.cropped(0.5, 0.5, SIZE, SIZE);
        let reference = Reference::new(reference, &Pose3::translation(-0.5, 0.0, 0.0), &camera);
        let mut votes =
            vec![Vote { inverse_depth, parallax_px: 8.0, ..Vote::default() }; SIZE / CELL];
        refine_votes(image, &[None, Some(reference)], SIZE / CELL / 2, FARTHEST, None, &mut votes);
        votes.drain(..3);
        votes.truncate(10);
        votes
    }

    #[test]
    fn a_match_half_a_pixel_off_is_corrected_whatever_the_exposure() {
        // 8 px at inverse depth 0.5; 8.5 px are 0.53125.
        let image = census(waves);
        for (gain, offset) in [(1.0, 0.0), (1.3, 10.0), (0.7, -5.0)] {
            let reference = census(|x, y| gain * waves(x + 8.0, y) + offset);
            for vote in refined(&image, &reference, 0.531_25) {
                assert!((vote.inverse_depth - 0.5).abs() < 0.1 / 16.0, "{}", vote.inverse_depth);
                assert!(vote.misfit < 0.05, "{}", vote.misfit);
            }
        }
    }

    #[test]
    fn where_the_image_is_flat_nothing_is_corrected_or_confirmed() {
        let flat = census(|x, _| 77.0 + x % 2.0);
        for vote in refined(&flat, &flat, 0.5) {
            assert!((vote.inverse_depth - 0.5).abs() < 1e-3 && vote.misfit > 0.8, "{vote:?}");
        }
    }

    #[test]
    fn another_object_has_a_large_misfit() {
        let other = census(|x, y| 120.0 + 50.0 * (0.7 * y - 0.5 * x).sin());
        let misfit: f32 =
            refined(&census(waves), &other, 0.5).iter().map(|vote| vote.misfit).sum::<f32>() / 10.0;
        assert!(misfit > 0.5, "{misfit}");
    }

    #[test]
    fn a_cell_that_no_reference_sees_is_not_corrected_or_confirmed() {
        // A parallax of 64 px leaves the image.
        let image = census(waves);
        for vote in refined(&image, &image, 4.0) {
            assert_eq!((vote.inverse_depth, vote.misfit), (4.0, 1.0));
        }
    }
}
