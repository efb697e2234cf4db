//! One picture of numbers with a border that repeats its edge, so that a look a little outside needs no question.

/// A row-major picture of f32 inside a border.
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

    /// Where pixel (0, `y`) is in `data`.
    pub fn start(&self, y: usize) -> usize {
        (y + self.border) * self.stride + self.border
    }

    /// Row `y` without its border.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[self.start(y)..][..self.width]
    }

    /// Row `y` without its border, to be written.
    pub fn row_mut(&mut self, y: usize) -> &mut [f32] {
        let start = self.start(y);
        &mut self.data[start..][..self.width]
    }

    /// Repeats the edge into the border.
    pub fn fill_border(&mut self) {
        let (border, stride, width) = (self.border, self.stride, self.width);
        for line in self.data.chunks_exact_mut(stride).skip(border).take(self.height) {
            let (first, last) = (line[border], line[border + width - 1]);
            line[..border].fill(first);
            line[border + width..].fill(last);
        }
        let (top, bottom) = (border * stride, (border + self.height - 1) * stride);
        for y in 0..border {
            self.data.copy_within(top..top + stride, y * stride);
            self.data.copy_within(bottom..bottom + stride, bottom + (y + 1) * stride);
        }
    }

    /// The value at (`x`, `y`) between pixels; outside, that of the nearest edge.
    #[inline(always)]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let right = usize::from(column + 1 < self.width);
        let down = if row + 1 < self.height { self.stride } else { 0 };
        let at = self.start(row) + column;
        let upper = lerp(self.data[at], self.data[at + right], fx);
        let lower = lerp(self.data[at + down], self.data[at + down + right], fx);
        lerp(upper, lower, fy)
    }
}

/// From `a` at 0 to `b` at 1.
#[inline(always)]
pub fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}
