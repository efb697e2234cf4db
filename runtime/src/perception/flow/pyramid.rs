//! A picture in halving sizes. A pixel of a scale is the mean of 2x2 of the next finer one; an odd last row or column is left
//! out, so that a place x of the picture is at (x + 1/2) / 2 - 1/2 everywhere.

use hal::{ImageView, PixelFormat};
use multiversion::multiversion;

use super::plane::Plane;

/// The border of every scale: a patch may lie just outside, and reads one pixel more.
pub const BORDER: usize = 16;

/// Grey pictures from full size (if it is looked at) to the coarsest scale.
#[derive(Debug, Clone)]
pub struct Pyramid {
    /// Index 0 is the full size; empty planes for scales that nobody looks at.
    pub scales: Vec<Plane>,
    finest: usize,
    rows: [Vec<f32>; 2],
}

impl Pyramid {
    pub fn new(width: usize, height: usize, finest: usize, coarsest: usize) -> Self {
        let plane = |scale: usize| match scale == 0 && finest > 0 {
            true => Plane::new(0, 0, 0),
            false => Plane::new(width >> scale, height >> scale, BORDER),
        };
        Self { scales: (0..=coarsest).map(plane).collect(), finest, rows: [vec![0.0; width], vec![0.0; width]] }
    }

    /// Fills every scale from a picture of the right size and format.
    pub fn fill(&mut self, picture: ImageView<'_>) {
        let [upper, lower] = &mut self.rows;
        let (scales, finest) = (&mut self.scales, self.finest);
        if finest == 0 {
            for y in 0..scales[0].height {
                grey_row(picture, y, scales[0].row_mut(y));
            }
        } else {
            for y in 0..scales[1].height {
                grey_row(picture, 2 * y, upper);
                grey_row(picture, 2 * y + 1, lower);
                halve(upper, lower, scales[1].row_mut(y));
            }
        }
        let next = if finest == 0 { 1 } else { 2 };
        for scale in next..scales.len() {
            let (fine, coarse) = scales.split_at_mut(scale);
            let (fine, coarse) = (&fine[scale - 1], &mut coarse[0]);
            for y in 0..coarse.height {
                halve(fine.row(2 * y), fine.row(2 * y + 1), coarse.row_mut(y));
            }
        }
        scales[finest..].iter_mut().for_each(Plane::fill_border);
    }
}

/// Row `y` as grey levels: Rec. 601 luma.
#[multiversion(targets("x86_64+avx2"))]
fn grey_row<'a>(picture: ImageView<'a>, y: usize, out: &mut [f32]) {
    let width = picture.width();
    if picture.format() == PixelFormat::Gray8 {
        for (out, grey) in out.iter_mut().zip(&picture.data()[y * width..][..width]) {
            *out = f32::from(*grey);
        }
    } else {
        for (out, rgb) in out.iter_mut().zip(picture.data()[y * width * 3..][..width * 3].chunks_exact(3)) {
            *out = 0.299 * f32::from(rgb[0]) + 0.587 * f32::from(rgb[1]) + 0.114 * f32::from(rgb[2]);
        }
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn halve(upper: &[f32], lower: &[f32], out: &mut [f32]) {
    for ((out, a), b) in out.iter_mut().zip(upper.chunks_exact(2)).zip(lower.chunks_exact(2)) {
        *out = 0.25 * ((a[0] + b[0]) + (a[1] + b[1]));
    }
}

/// Central differences along x and y, grey levels a pixel. The picture's border must be filled.
#[multiversion(targets("x86_64+avx2"))]
pub fn gradients(picture: &Plane, along_x: &mut Plane, along_y: &mut Plane) {
    let (width, stride) = (picture.width, picture.stride);
    for y in 0..picture.height {
        let start = picture.start(y);
        let (left, right) = (&picture.data[start - 1..][..width], &picture.data[start + 1..][..width]);
        for ((out, l), r) in along_x.row_mut(y).iter_mut().zip(left).zip(right) {
            *out = 0.5 * (r - l);
        }
        let (up, down) = (&picture.data[start - stride..][..width], &picture.data[start + stride..][..width]);
        for ((out, u), d) in along_y.row_mut(y).iter_mut().zip(up).zip(down) {
            *out = 0.5 * (d - u);
        }
    }
}
