//! The result of dense optical flow.

/// For every pixel, the displacement to its match in another image, pixels. NaN where there is no match.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowField {
    width: usize,
    height: usize,
    flow_px: Vec<[f32; 2]>,
}

impl FlowField {
    /// A field of zero displacements.
    #[must_use]
    pub fn zero(width: usize, height: usize) -> Self {
        Self { width, height, flow_px: vec![[0.0; 2]; width * height] }
    }

    /// A field from row-major (x, y) displacements; `None` when their number is not `width * height`.
    #[must_use]
    pub fn from_vec(width: usize, height: usize, flow_px: Vec<[f32; 2]>) -> Option<Self> {
        (Some(flow_px.len()) == width.checked_mul(height)).then_some(Self {
            width,
            height,
            flow_px,
        })
    }

    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row-major (x, y) displacements, pixels.
    #[must_use]
    pub fn values(&self) -> &[[f32; 2]] {
        &self.flow_px
    }

    /// Row-major (x, y) displacements, pixels, for writing.
    #[must_use]
    pub fn values_mut(&mut self) -> &mut [[f32; 2]] {
        &mut self.flow_px
    }
}
