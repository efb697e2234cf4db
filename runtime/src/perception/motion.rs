//! Where everything in a picture was in the picture before.

use hal::{ImageView, PixelFormat};

use super::census::CensusImage;
use super::flow::{DenseFlow, FlowConfig, FlowError, FlowField, FlowPreset};
use crate::snapshot::remembers;

/// Dense flow from every picture to the one before.
#[derive(Debug)]
pub struct PictureMotion {
    flow: DenseFlow,
    /// Grey values, one byte a pixel.
    now: Vec<u8>,
    before: Vec<u8>,
    has_before: bool,
}

impl PictureMotion {
    /// For pictures of this size.
    ///
    /// # Errors
    /// Pictures that are too small.
    pub fn new(width: usize, height: usize) -> Result<Self, FlowError> {
        // Between one picture and the next, refinement made depth no better.
        let config = FlowConfig { variational_iterations: 0, ..FlowPreset::UltraFast.into() };
        let flow = DenseFlow::new(config, width, height)?;
        Ok(Self {
            flow,
            now: vec![0; width * height],
            before: vec![0; width * height],
            has_before: false,
        })
    }

    /// Forgets the picture before.
    pub fn forget(&mut self) {
        self.has_before = false;
    }

    /// Whether its pictures have so many pixels.
    pub fn has_size(&self, pixels: usize) -> bool {
        self.now.len() == pixels
    }

    /// From this picture to the one before; `None` for the first.
    pub fn follow(&mut self, picture: &CensusImage) -> Option<&FlowField> {
        std::mem::swap(&mut self.now, &mut self.before);
        self.now
            .iter_mut()
            .zip(&picture.smooth)
            .for_each(|(now, smooth)| *now = (smooth >> 8) as u8);
        if !std::mem::replace(&mut self.has_before, true) {
            return None;
        }
        let grey =
            |data| ImageView::new(picture.width, picture.height, PixelFormat::Gray8, data).ok();
        self.flow.flow(grey(&self.now)?, grey(&self.before)?, None).ok()
    }
}

remembers!(PictureMotion: now, has_before);
