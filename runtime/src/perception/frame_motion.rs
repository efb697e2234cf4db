//! Dense flow from every frame to the one before.

use hal::{ImageView, PixelFormat};

use super::census::CensusImage;
use super::flow::{DenseFlow, FlowConfig, FlowError, FlowField, FlowPreset};
use crate::snapshot::remembers;

/// Computes the flow from every frame to the one before.
#[derive(Debug)]
pub struct FrameMotion {
    flow: DenseFlow,
    /// Grey values, one byte per pixel.
    now: Vec<u8>,
    before: Vec<u8>,
    has_before: bool,
}

impl FrameMotion {
    /// # Errors
    /// When the frames are smaller than a patch of the flow.
    pub fn new(width: usize, height: usize) -> Result<Self, FlowError> {
        // Between one frame and the next, variational refinement did not improve depth.
        let config = FlowConfig { variational_iterations: 0, ..FlowPreset::UltraFast.into() };
        let flow = DenseFlow::new(config, width, height)?;
        Ok(Self {
            flow,
            now: vec![0; width * height],
            before: vec![0; width * height],
            has_before: false,
        })
    }

    /// Forgets the frame before.
    pub fn forget(&mut self) {
        self.has_before = false;
    }

    /// Whether its frames have this number of pixels.
    pub fn has_size(&self, pixels: usize) -> bool {
        self.now.len() == pixels
    }

    /// The flow from this frame to the one before; `None` for the first frame.
    pub fn update(&mut self, image: &CensusImage) -> Option<&FlowField> {
        std::mem::swap(&mut self.now, &mut self.before);
        self.now.iter_mut().zip(&image.smooth).for_each(|(now, smooth)| *now = (smooth >> 8) as u8);
        if !std::mem::replace(&mut self.has_before, true) {
            return None;
        }
        let now = ImageView::new(image.width, image.height, PixelFormat::Gray8, &self.now).ok()?;
        let before =
            ImageView::new(image.width, image.height, PixelFormat::Gray8, &self.before).ok()?;
        self.flow.flow(now, before).ok()
    }
}

remembers!(FrameMotion: now, has_before);
