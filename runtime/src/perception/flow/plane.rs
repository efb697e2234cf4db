//! An f32 image with a border that repeats its edge, so that reading slightly outside needs no bounds check.

/// A row-major f32 image with a border.
#[derive(Debug, Clone)]
pub struct Plane {
    pub width: usize,
    pub height: usize,
    pub border: usize,
    pub stride: usize,
    pub data: Vec<f32>,
}

impl Plane {
    pub fn new(width: usize, height: usize, border: usize) -> Self {
        let stride = width + 2 * border;
        Self { width, height, border, stride, data: vec![0.0; stride * (height + 2 * border)] }
    }

    /// Index of pixel (0, `y`) in `data`.
    pub fn start(&self, y: usize) -> usize {
        (y + self.border) * self.stride + self.border
    }

    /// Row `y` without its border.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[self.start(y)..][..self.width]
    }

    /// Row `y` without its border, for writing.
    pub fn row_mut(&mut self, y: usize) -> &mut [f32] {
        let start = self.start(y);
        &mut self.data[start..][..self.width]
    }

    /// Copies the edge pixels into the border.
    pub fn fill_border(&mut self) {
        let border = self.border;
        let stride = self.stride;
        let width = self.width;
        for line in self.data.chunks_exact_mut(stride).skip(border).take(self.height) {
            let first = line[border];
            let last = line[border + width - 1];
            line[..border].fill(first);
            line[border + width..].fill(last);
        }
        let top = border * stride;
        let bottom = (border + self.height - 1) * stride;
        for y in 0..border {
            self.data.copy_within(top..top + stride, y * stride);
            self.data.copy_within(bottom..bottom + stride, bottom + (y + 1) * stride);
        }
    }

    /// The bilinear value at (`x`, `y`); outside, that of the nearest edge.
    #[inline(always)]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let column = x as usize;
        let row = y as usize;
        let fx = x - column as f32;
        let fy = y - row as f32;
        let right = usize::from(column + 1 < self.width);
        let down = if row + 1 < self.height { self.stride } else { 0 };
        let at = self.start(row) + column;
        let upper = lerp(self.data[at], self.data[at + right], fx);
        let lower = lerp(self.data[at + down], self.data[at + down + right], fx);
        lerp(upper, lower, fy)
    }
}

/// Linear interpolation from `a` at t = 0 to `b` at t = 1.
#[inline(always)]
pub fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}
