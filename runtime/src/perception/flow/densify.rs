//! Converts the flow of patches to the flow of pixels: the mean over the patches that cover a pixel, weighted by how well each
//! matches it.

use multiversion::multiversion;
use rayon::prelude::*;

use super::PATCH;
use super::plane::{Plane, lerp};
use super::search::{PatchGrid, Window};

/// Rows that one task fills.
const BAND_ROWS: usize = 16;

/// Fills `flow` (x and y, row-major); `weight` is scratch memory of the same size.
pub fn densify(
    grid: &PatchGrid,
    from: &Plane,
    to: &Plane,
    flow: &mut [Vec<f32>; 2],
    weight: &mut [f32],
) {
    let band = BAND_ROWS * from.width;
    let [u, v] = flow;
    let bands = u.par_chunks_mut(band).zip(v.par_chunks_mut(band)).zip(weight.par_chunks_mut(band));
    bands.enumerate().for_each(|(index, ((u, v), weight))| {
        fill(grid, from, to, index * BAND_ROWS, u, v, weight);
    });
}

/// Every patch adds to its pixels in the band. Patches come in the same order for every pixel, however the image is split into
/// bands, so that sums are the same to the last bit.
#[multiversion(targets("x86_64+avx2"))]
fn fill(
    grid: &PatchGrid,
    from: &Plane,
    to: &Plane,
    first: usize,
    u: &mut [f32],
    v: &mut [f32],
    weight: &mut [f32],
) {
    let width = from.width;
    let end = first + u.len() / width;
    u.fill(0.0);
    v.fill(0.0);
    weight.fill(0.0);
    for row in (0..grid.rows).filter(|row| grid.top(*row) < end && grid.top(*row) + PATCH > first) {
        let top = grid.top(row);
        let begin = first.max(top) - top;
        let stop = end.min(top + PATCH) - top;
        for column in 0..grid.columns {
            let left = grid.left(column);
            let found = grid.found[row * grid.columns + column];
            let window = Window::at(to, (left, top), found.flow);
            let mut upper = window.line(begin);
            for y in begin..stop {
                let lower = window.line(y + 1);
                let here = (top + y - first) * width + left;
                let grey = &from.data[from.start(top + y) + left..][..PATCH];
                let u = &mut u[here..][..PATCH];
                let v = &mut v[here..][..PATCH];
                let weight = &mut weight[here..][..PATCH];
                for k in 0..PATCH {
                    let difference = lerp(upper[k], lower[k], window.fy) - grey[k] - found.mean;
                    let w = 1.0 / difference.abs().max(1.0);
                    u[k] += w * found.flow[0];
                    v[k] += w * found.flow[1];
                    weight[k] += w;
                }
                upper = lower;
            }
        }
    }
    for ((u, v), weight) in u.iter_mut().zip(v).zip(weight) {
        *u /= *weight;
        *v /= *weight;
    }
}
