//! An image pyramid. A pixel of a scale is the mean of 2x2 pixels of the next finer one; an odd last row or column is left
//! out, so that position x of a scale is at (x + 1/2) / 2 - 1/2 in the next coarser one.

use hal::{ImageView, PixelFormat};
use multiversion::multiversion;

use super::plane::Plane;

/// The border of every scale, pixels: a patch may lie just outside, and reads one pixel more.
pub const BORDER: usize = 16;

/// Grey images from full size (where it is searched) to the coarsest scale.
#[derive(Debug, Clone)]
pub struct Pyramid {
    /// Index 0 is the full size; the plane is empty where that scale is not searched.
    pub scales: Vec<Plane>,
    finest: usize,
    lines: [Vec<f32>; 4],
    line: Vec<f32>,
}

impl Pyramid {
    pub fn new(width: usize, height: usize, finest: usize, coarsest: usize) -> Self {
        let full_size_is_searched = finest == 0;
        let scales = (0..=coarsest).map(|scale| {
            if scale > 0 || full_size_is_searched {
                Plane::new(width >> scale, height >> scale, BORDER)
            } else {
                Plane::new(0, 0, 0)
            }
        });
        Self {
            scales: scales.collect(),
            finest,
            lines: std::array::from_fn(|_| vec![0.0; width]),
            line: vec![0.0; width + 2],
        }
    }

    /// Fills every scale from an image of the right size and format.
    pub fn fill(&mut self, image: ImageView<'_>) {
        let scales = &mut self.scales;
        let finest = self.finest;
        if finest == 0 {
            for y in 0..scales[0].height {
                grey_row(image, y, scales[0].row_mut(y));
            }
        } else {
            // Row y of the image is kept in line y % 4.
            let lines = &mut self.lines;
            for y in 0..2 {
                grey_row(image, y, &mut lines[y]);
            }
            for y in 0..scales[1].height {
                for next in [2 * y + 1, 2 * y + 2] {
                    if next < image.height() {
                        grey_row(image, next, &mut lines[next % 4]);
                    }
                }
                let four = four_rows(y, image.height()).map(|row| lines[row % 4].as_slice());
                halve(four, &mut self.line, scales[1].row_mut(y));
            }
        }
        for scale in if finest == 0 { 1 } else { 2 }..scales.len() {
            let (fine, coarse) = scales.split_at_mut(scale);
            let fine = &fine[scale - 1];
            let coarse = &mut coarse[0];
            for y in 0..coarse.height {
                let four = four_rows(y, fine.height).map(|row| fine.row(row));
                halve(four, &mut self.line, coarse.row_mut(y));
            }
        }
        scales[finest..].iter_mut().for_each(Plane::fill_border);
    }
}

/// The four rows from which row `y` of half the size is computed.
fn four_rows(y: usize, height: usize) -> [usize; 4] {
    [(2 * y).saturating_sub(1), 2 * y, 2 * y + 1, (2 * y + 2).min(height - 1)]
}

/// Rec. 601 luma of red, green and blue.
#[inline(always)]
pub fn luma(rgb: &[u8]) -> f32 {
    0.299 * f32::from(rgb[0]) + 0.587 * f32::from(rgb[1]) + 0.114 * f32::from(rgb[2])
}

/// Converts row `y` to grey levels.
#[multiversion(targets("x86_64+avx2"))]
fn grey_row<'a>(image: ImageView<'a>, y: usize, out: &mut [f32]) {
    let width = image.width();
    if image.format() == PixelFormat::Gray8 {
        for (out, grey) in out.iter_mut().zip(&image.data()[y * width..][..width]) {
            *out = f32::from(*grey);
        }
    } else {
        for (out, rgb) in
            out.iter_mut().zip(image.data()[y * width * 3..][..width * 3].chunks_exact(3))
        {
            *out = luma(rgb);
        }
    }
}

/// One row of half the size, filtered with 1 3 3 1 along both directions.
#[multiversion(targets("x86_64+avx2"))]
fn halve(rows: [&[f32]; 4], line: &mut [f32], out: &mut [f32]) {
    let n = rows[0].len();
    let [a, b, c, d] = rows.map(|row| &row[..n]);
    // The ends of the line are repeated.
    let middle = &mut line[1..=n];
    for x in 0..n {
        middle[x] = (a[x] + d[x]) + 3.0 * (b[x] + c[x]);
    }
    line[0] = line[1];
    line[n + 1] = line[n];
    for (x, out) in out.iter_mut().enumerate() {
        let near = &line[2 * x..][..4];
        *out = ((near[0] + near[3]) + 3.0 * (near[1] + near[2])) / 64.0;
    }
}

/// Central differences along x and y, grey levels per pixel. The image's border must be filled.
#[multiversion(targets("x86_64+avx2"))]
pub fn gradients(image: &Plane, along_x: &mut Plane, along_y: &mut Plane) {
    let width = image.width;
    let stride = image.stride;
    for y in 0..image.height {
        let start = image.start(y);
        let left = &image.data[start - 1..][..width];
        let right = &image.data[start + 1..][..width];
        for ((out, l), r) in along_x.row_mut(y).iter_mut().zip(left).zip(right) {
            *out = 0.5 * (r - l);
        }
        let up = &image.data[start - stride..][..width];
        let down = &image.data[start + stride..][..width];
        for ((out, u), d) in along_y.row_mut(y).iter_mut().zip(up).zip(down) {
            *out = 0.5 * (d - u);
        }
    }
}
