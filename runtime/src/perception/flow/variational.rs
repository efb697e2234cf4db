//! Variational refinement: finds the smooth flow that matches brightness and gradients of both images, with robust
//! penalties on all three (Brox, Bruhn, Papenberg and Weickert 2004), its terms normalised (Zimmer, Bruhn and Weickert 2011).
//!
//! With the second image warped once by the flow (u0, v0), each term is linear in the flow (u, v); its robust penalty
//! sqrt(r^2 + e^2) is reweighted in every iteration, and the linear system is relaxed by red-black successive
//! over-relaxation.
//!
//! The image is split into a fixed number of bands of rows. A band also relaxes a few rows of its neighbours, as many as there
//! are half sweeps, so its own rows get exactly the values that a relaxation of the whole image would give them.

use std::ops::Range;

use rayon::prelude::*;

use super::energy::{self, HALF_SWEEPS};
use super::plane::Plane;
use super::split::{Part, Split};

/// Minimum number of rows in a band: with fewer, relaxing the neighbours' rows costs more than a second thread saves.
const BAND_ROWS: usize = 24;
/// Maximum number of bands.
const MOST_BANDS: usize = 16;

/// The refinement and its buffers for one image size.
#[derive(Debug, Clone)]
pub struct Variational {
    bands: Vec<Band>,
    /// The flow before the next iteration, x and y.
    flow: [Split; 2],
}

impl Variational {
    pub fn new(width: usize, height: usize) -> Self {
        Self::with_bands(width, height, (height / BAND_ROWS).clamp(1, MOST_BANDS))
    }

    fn with_bands(width: usize, height: usize, count: usize) -> Self {
        let bands = (0..count).map(|band| {
            Band::new(width, height, band * height / count, (band + 1) * height / count)
        });
        Self {
            bands: bands.collect(),
            flow: [Split::new(width, height), Split::new(width, height)],
        }
    }

    /// Refines `flow` (x and y, row-major) in place.
    pub fn refine(
        &mut self,
        from: &Plane,
        to: &Plane,
        flow: &mut [Vec<f32>; 2],
        iterations: usize,
    ) {
        let width = from.width;
        for (split, plane) in self.flow.iter_mut().zip(flow.iter()) {
            plane.chunks_exact(width).enumerate().for_each(|(y, row)| split.split_row(y, row));
        }
        self.bands.par_iter_mut().for_each(|band| band.linearise(from, to, flow));
        for _ in 0..iterations {
            let before = &self.flow;
            self.bands.par_iter_mut().for_each(|band| band.iterate(before));
            for band in &self.bands {
                for (all, own) in self.flow.iter_mut().zip([&band.u, &band.v]) {
                    for y in band.own.clone() {
                        all.row_mut(y).copy_from_slice(own.row(y - band.rows.start));
                    }
                }
            }
        }
        for (split, plane) in self.flow.iter().zip(flow) {
            plane.chunks_exact_mut(width).enumerate().for_each(|(y, row)| split.join_row(y, row));
        }
    }
}

/// A band of rows, with the neighbouring rows that it depends on.
#[derive(Debug, Clone)]
struct Band {
    /// Rows of the image whose flow this band computes.
    own: Range<usize>,
    /// The rows that it relaxes: `own` and up to `HALF_SWEEPS` more at each end.
    rows: Range<usize>,
    /// Whether `rows` reach the image's upper and lower edge.
    edge: [bool; 2],
    /// Mean of the two images and change from the first to the second, with two more rows and columns for derivatives.
    mean: Plane,
    change: Plane,
    inside: Plane,
    terms: Terms,
    links: Links,
    system: System,
    u: Split,
    v: Split,
}

/// The linear terms `x u + y v + t` of brightness and of the gradient along x and along y, each divided by the length of its
/// own gradient.
#[derive(Debug, Clone)]
struct Terms {
    planes: [Split; 9],
    line: [Vec<f32>; 9],
}

/// Smoothness weights between a pixel's flow and that of the pixel right of it and of the pixel below it.
#[derive(Debug, Clone)]
struct Links {
    right: Split,
    below: Split,
}

/// The linear system of one iteration: each pixel's `u = (sum of links * neighbours + b_u - cross v) * inverse_u`.
#[derive(Debug, Clone)]
struct System {
    inverse: [Split; 2],
    cross: Split,
    b: [Split; 2],
}

impl Band {
    fn new(width: usize, height: usize, first: usize, end: usize) -> Self {
        let rows = first.saturating_sub(HALF_SWEEPS)..(end + HALF_SWEEPS).min(height);
        let count = rows.len();
        let split = Split::new(width, count);
        let height_with_derivatives = rows_for_derivatives(&rows, height).len();
        Self {
            own: first..end,
            edge: [rows.start == 0, rows.end == height],
            rows,
            mean: Plane::new(width, height_with_derivatives, 2),
            change: Plane::new(width, height_with_derivatives, 2),
            inside: Plane::new(width, height_with_derivatives, 0),
            terms: Terms {
                planes: std::array::from_fn(|_| split.clone()),
                line: std::array::from_fn(|_| vec![0.0; width]),
            },
            links: Links { right: split.clone(), below: split.clone() },
            system: System {
                inverse: [split.clone(), split.clone()],
                cross: split.clone(),
                b: [split.clone(), split.clone()],
            },
            u: split.clone(),
            v: split,
        }
    }

    /// Warps the second image by the flow and fills the linear terms.
    fn linearise(&mut self, from: &Plane, to: &Plane, flow: &[Vec<f32>; 2]) {
        let all = rows_for_derivatives(&self.rows, from.height);
        let width = from.width;
        for (line, y) in all.clone().enumerate() {
            let u = &flow[0][y * width..][..width];
            let v = &flow[1][y * width..][..width];
            let mean = self.mean.row_mut(line);
            let change = self.change.row_mut(line);
            energy::warp(from.row(y), to, y, u, v, mean, change, self.inside.row_mut(line));
        }
        self.mean.fill_border();
        self.change.fill_border();
        for (line, y) in self.rows.clone().enumerate() {
            let u = &flow[0][y * width..][..width];
            let v = &flow[1][y * width..][..width];
            self.derive(y - all.start, u, v);
            for (plane, row) in self.terms.planes.iter_mut().zip(&self.terms.line) {
                plane.split_row(line, row);
            }
        }
    }

    /// Fills the linear terms of a row, in the order of its pixels.
    fn derive(&mut self, y: usize, u0: &[f32], v0: &[f32]) {
        let mean = Around { plane: &self.mean, y };
        let change = Around { plane: &self.change, y };
        let [x0, y0, t0, x1, y1, t1, x2, y2, t2] = &mut self.terms.line;
        energy::difference(mean.at(1, 0), mean.at(-1, 0), 0.5, x0);
        energy::difference(mean.at(0, 1), mean.at(0, -1), 0.5, y0);
        t0.copy_from_slice(change.at(0, 0));
        energy::second(mean.at(-2, 0), mean.at(0, 0), mean.at(2, 0), x1);
        energy::mixed([mean.at(-1, -1), mean.at(1, -1), mean.at(-1, 1), mean.at(1, 1)], y1);
        energy::difference(change.at(1, 0), change.at(-1, 0), 0.5, t1);
        x2.copy_from_slice(y1);
        energy::second(mean.at(0, -2), mean.at(0, 0), mean.at(0, 2), y2);
        energy::difference(change.at(0, 1), change.at(0, -1), 0.5, t2);
        for (x, y_, t) in [(x0, y0, t0), (x1, y1, t1), (x2, y2, t2)] {
            energy::normalise(x, y_, t, self.inside.row(y), u0, v0);
        }
    }

    /// One reweighting and its sweeps. Half sweep k follows one row behind half sweep k - 1, so that the current rows stay in
    /// the cache; the result equals that of one half sweep over all rows after the other.
    fn iterate(&mut self, before: &[Split; 2]) {
        let rows = self.rows.len();
        self.u.rows_mut(0, rows).copy_from_slice(before[0].rows(self.rows.start, rows));
        self.v.rows_mut(0, rows).copy_from_slice(before[1].rows(self.rows.start, rows));
        for step in 0..rows + HALF_SWEEPS {
            if step < rows {
                self.bind(step);
                self.assemble(step);
            }
            for half_sweep in 0..HALF_SWEEPS.min(step + 1) {
                let y = step - half_sweep;
                // The band's first and last row lack a neighbour; every half sweep makes one row more at each end invalid.
                let [above, below] = self.edge.map(|edge| if edge { 0 } else { half_sweep + 1 });
                if y >= above && y + below < rows {
                    self.relax(y, half_sweep);
                }
            }
        }
    }

    /// Fills the links of a row. Its flow and the next row's are still those of the last iteration.
    fn bind(&mut self, y: usize) {
        self.u.repeat_last_column(y);
        self.v.repeat_last_column(y);
        let last = y + 1 == self.rows.len();
        let next = if last { y } else { y + 1 };
        for part in [Part::Even, Part::Odd] {
            let right = self.links.right.part_mut(y, part);
            let [u, v] = [&self.u, &self.v]
                .map(|w| [w.part(y, part), w.right_of(y, part), w.part(next, part)]);
            energy::bind(u, v, right);
            self.links.below.part_mut(y, part).copy_from_slice(right);
        }
        self.links.right.set_last_column(y, 0.0);
        if last {
            self.links.below.row_mut(y).fill(0.0);
        }
    }

    /// Fills the linear system of a row.
    fn assemble(&mut self, y: usize) {
        let flow = [self.u.row(y), self.v.row(y)];
        let terms = std::array::from_fn(|term| self.terms.planes[term].row(y));
        let [inverse_u, inverse_v] = &mut self.system.inverse;
        let [b_u, b_v] = &mut self.system.b;
        let a_u = inverse_u.row_mut(y);
        let a_v = inverse_v.row_mut(y);
        let cross = self.system.cross.row_mut(y);
        energy::assemble(flow, terms, a_u, a_v, cross, b_u.row_mut(y), b_v.row_mut(y));
        for part in [Part::Even, Part::Odd] {
            let right = &self.links.right;
            let below = &self.links.below;
            let links = [
                right.part(y, part),
                right.left_of(y, part),
                below.part(y, part),
                below.part_above(y, part),
            ];
            for inverse in &mut self.system.inverse {
                energy::invert(links, inverse.part_mut(y, part));
            }
        }
    }

    /// Relaxes every other pixel of a row.
    fn relax(&mut self, y: usize, half_sweep: usize) {
        let part = if (self.rows.start + y + half_sweep).is_multiple_of(2) {
            Part::Even
        } else {
            Part::Odd
        };
        let right = &self.links.right;
        let below = &self.links.below;
        let links = [
            right.left_of(y, part),
            right.part(y, part),
            below.part_above(y, part),
            below.part(y, part),
        ];
        let cross = self.system.cross.part(y, part);
        let [inverse_u, inverse_v] =
            self.system.inverse.each_ref().map(|plane| plane.part(y, part));
        let [b_u, b_v] = self.system.b.each_ref().map(|plane| plane.part(y, part));
        let (own, neighbours) = self.u.cross(y, part);
        energy::relax(own, neighbours, links, [inverse_u, b_u, cross], self.v.part(y, part));
        let (own, neighbours) = self.v.cross(y, part);
        energy::relax(own, neighbours, links, [inverse_v, b_v, cross], self.u.part(y, part));
    }
}

/// A row of a plane, from which shifted rows can be read.
#[derive(Clone, Copy)]
struct Around<'a> {
    plane: &'a Plane,
    y: usize,
}

impl<'a> Around<'a> {
    /// The row shifted by (`dx`, `dy`), both within the border.
    fn at(&self, dx: isize, dy: isize) -> &'a [f32] {
        let first = self.plane.start(self.y) as isize + dy * self.plane.stride as isize + dx;
        &self.plane.data[first as usize..][..self.plane.width]
    }
}

/// `rows` and the rows around them that their derivatives read.
fn rows_for_derivatives(rows: &Range<usize>, height: usize) -> Range<usize> {
    rows.start.saturating_sub(2)..(rows.end + 2).min(height)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waves(width: usize, height: usize, phase: f32) -> Plane {
        let mut plane = Plane::new(width, height, super::super::pyramid::BORDER);
        for y in 0..height {
            for (x, grey) in plane.row_mut(y).iter_mut().enumerate() {
                let x = x as f32 + phase;
                let y = y as f32;
                *grey = 128.0 + 50.0 * (0.5 * x + 0.2 * y).sin() + 40.0 * (0.3 * y - 0.1 * x).cos();
            }
        }
        plane.fill_border();
        plane
    }

    fn refined(from: &Plane, to: &Plane, bands: usize) -> [Vec<f32>; 2] {
        let pixels = from.width * from.height;
        let mut flow = [vec![-0.1; pixels], vec![0.05; pixels]];
        Variational::with_bands(from.width, from.height, bands).refine(from, to, &mut flow, 20);
        flow
    }

    #[test]
    fn any_number_of_bands_gives_the_same_bits_as_the_whole_image() {
        for (width, height) in [(37, 61), (40, 64)] {
            let from = waves(width, height, 0.0);
            let to = waves(width, height, 0.4);
            let whole = refined(&from, &to, 1);
            let mean = whole[0].iter().sum::<f32>() / (width * height) as f32;
            assert!((mean + 0.4).abs() < 0.1, "{mean}");
            for bands in [2, 3, 5, 20] {
                assert_eq!(refined(&from, &to, bands), whole, "{bands} bands");
            }
        }
    }
}
