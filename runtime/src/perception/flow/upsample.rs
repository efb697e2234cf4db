//! Upsamples the flow of the finest scale to the full image.

use multiversion::multiversion;
use rayon::prelude::*;

use super::field::FlowField;
use super::plane::lerp;

/// Rows that one task fills.
const BAND_ROWS: usize = 32;

/// Fills `out` from `flow` (x and y, row-major, `width` columns, pixels of an image 2^`scale` times smaller) by bilinear
/// interpolation. `lines` holds one line for each band of [`bands`].
pub fn upsample(
    flow: &[Vec<f32>; 2],
    width: usize,
    scale: usize,
    lines: &mut [Vec<[f32; 2]>],
    out: &mut FlowField,
) {
    let columns = out.width();
    let bands = out.values_mut().par_chunks_mut(BAND_ROWS * columns).zip(lines);
    bands.enumerate().for_each(|(band, (out, line))| match scale {
        0 => fill::<1>(flow, width, band * BAND_ROWS, columns, line, out),
        1 => fill::<2>(flow, width, band * BAND_ROWS, columns, line, out),
        2 => fill::<4>(flow, width, band * BAND_ROWS, columns, line, out),
        3 => fill::<8>(flow, width, band * BAND_ROWS, columns, line, out),
        _ => fill::<16>(flow, width, band * BAND_ROWS, columns, line, out),
    });
}

/// Number of tasks for an image of this height.
pub fn bands(height: usize) -> usize {
    height.div_ceil(BAND_ROWS)
}

fn fill<const FACTOR: usize>(
    flow: &[Vec<f32>; 2],
    width: usize,
    first: usize,
    columns: usize,
    line: &mut [[f32; 2]],
    out: &mut [[f32; 2]],
) {
    let height = flow[0].len() / width;
    for (y, out) in out.chunks_exact_mut(columns).enumerate() {
        let at = (((first + y) as f32 + 0.5) / FACTOR as f32 - 0.5).clamp(0.0, (height - 1) as f32);
        let upper = at as usize;
        let lower = (at as usize + 1).min(height - 1);
        let [u, v] = flow;
        let rows = [
            &u[upper * width..][..width],
            &u[lower * width..][..width],
            &v[upper * width..][..width],
            &v[lower * width..][..width],
        ];
        between_rows(rows, at - upper as f32, FACTOR as f32, line);
        match FACTOR {
            1 => out.copy_from_slice(&line[1..=columns]),
            2 => between_columns_2(line, out),
            4 => between_columns_4(line, out),
            _ => between_columns::<FACTOR>(line, out),
        }
    }
}

/// Interpolates one line of flow between two rows, in full-size pixels, with its ends repeated.
#[multiversion(targets("x86_64+avx2"))]
fn between_rows(rows: [&[f32]; 4], t: f32, factor: f32, line: &mut [[f32; 2]]) {
    let n = rows[0].len();
    let [u_upper, u_lower, v_upper, v_lower] = rows.map(|row| &row[..n]);
    let middle = &mut line[1..=n];
    for x in 0..n {
        middle[x] =
            [factor * lerp(u_upper[x], u_lower[x], t), factor * lerp(v_upper[x], v_lower[x], t)];
    }
    line[0] = line[1];
    line[n + 1] = line[n];
}

#[multiversion(targets("x86_64+avx2"))]
fn between_columns_2(line: &[[f32; 2]], out: &mut [[f32; 2]]) {
    between_columns::<2>(line, out);
}

#[multiversion(targets("x86_64+avx2"))]
fn between_columns_4(line: &[[f32; 2]], out: &mut [[f32; 2]]) {
    between_columns::<4>(line, out);
}

/// Each pixel of the line gives `FACTOR` pixels; columns that the small image leaves out repeat the last one.
#[inline(always)]
fn between_columns<const FACTOR: usize>(line: &[[f32; 2]], out: &mut [[f32; 2]]) {
    let end = line[line.len() - 1];
    let mut groups = out.chunks_exact_mut(FACTOR);
    for (group, near) in groups.by_ref().zip(line.windows(3)) {
        for phase in 0..FACTOR {
            let t = (phase as f32 + 0.5) / FACTOR as f32 - 0.5;
            let (a, b, t) =
                if t < 0.0 { (near[0], near[1], t + 1.0) } else { (near[1], near[2], t) };
            group[phase] = [lerp(a[0], b[0], t), lerp(a[1], b[1], t)];
        }
    }
    groups.into_remainder().fill(end);
}
