//! Settings of the optical-flow engine, and what can be wrong with them.

use hal::settings::OutOfRange;
use serde::{Deserialize, Serialize};

/// Trade-off between accuracy and time: the presets of OpenCV's `DISOpticalFlow`, with its names. With each of them, errors and
/// time are below OpenCV's (`cargo xtask bench "optical flow"`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowPreset {
    /// Starts at a quarter of the size, with hardly any refinement.
    UltraFast,
    /// Starts at a quarter of the size, with variational refinement.
    Fast,
    /// Starts at half the size, with patches closer together and variational refinement.
    Medium,
}

hal::settings! {
    /// Settings of the dense optical flow. Patches are 8x8 pixels. The defaults are those of [`FlowPreset::Medium`].
    pub struct FlowConfig {
        /// The finest scale of the search: 0 is the full image, 1 half its size, and so on.
        finest_scale: usize = 1, in 0..=4;
        /// Distance between two patches, in pixels of the scale; at most the size of a patch.
        patch_stride_px: usize = 3, in 1..=8, unit "pixels";
        /// Largest number of steps of gradient descent for each patch and scale.
        descent_iterations: usize = 25, in 1..=1000;
        /// Iterations of the variational refinement at each scale; 0 refines nothing.
        variational_iterations: usize = 7, in 0..=100;
    }
}

impl From<FlowPreset> for FlowConfig {
    /// The numbers are those that OpenCV documents for its presets, except for the iterations of the refinement (0, 5 and 5
    /// there): ours take so little time that we use more.
    fn from(preset: FlowPreset) -> Self {
        match preset {
            FlowPreset::UltraFast => Self {
                finest_scale: 2,
                patch_stride_px: 4,
                descent_iterations: 12,
                variational_iterations: 1,
            },
            FlowPreset::Fast => Self {
                finest_scale: 2,
                patch_stride_px: 4,
                descent_iterations: 16,
                variational_iterations: 6,
            },
            FlowPreset::Medium => Self::default(),
        }
    }
}

/// Why the flow cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FlowError {
    /// A setting is not allowed.
    #[error("flow: {field} = {value} is not allowed; allowed: {allowed}")]
    Setting {
        field: &'static str,
        value: usize,
        /// The values that are allowed.
        allowed: &'static str,
    },
    /// An image or a flow field has another size than the engine was made for.
    #[error(
        "flow: {what} is {width}x{height}, {want_width}x{want_height} is needed; resample it, or make a DenseFlow of its size"
    )]
    Size {
        /// Which of the images or flow fields it is.
        what: &'static str,
        width: usize,
        height: usize,
        /// Columns of the engine.
        want_width: usize,
        /// Rows of the engine.
        want_height: usize,
    },
    /// The engine cannot read the format of an image.
    #[error("flow: {what} is a {format:?} image; convert it to RGB8 or GRAY8")]
    Format {
        /// Which of the images it is.
        what: &'static str,
        format: hal::PixelFormat,
    },
}

impl FlowError {
    /// Refuses a `size` (columns, rows) that is not the one that the engine was made for.
    pub(super) fn check_size(
        what: &'static str,
        size: (usize, usize),
        want: (usize, usize),
    ) -> Result<(), Self> {
        if size == want {
            return Ok(());
        }
        let (width, height) = size;
        let (want_width, want_height) = want;
        Err(Self::Size { what, width, height, want_width, want_height })
    }
}

impl From<OutOfRange> for FlowError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        // Every setting is a whole number.
        Self::Setting { field: key, value: value as usize, allowed }
    }
}

impl FlowConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the field, its value and the allowed values.
    pub fn validate(&self) -> Result<(), FlowError> {
        Ok(self.check_ranges()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_are_allowed() {
        for preset in [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium] {
            assert_eq!(FlowConfig::from(preset).validate(), Ok(()));
        }
    }

    #[test]
    fn values_that_are_not_allowed_are_refused_by_name() {
        let good = FlowConfig::default;
        for (bad, name) in [
            (FlowConfig { finest_scale: 5, ..good() }, "finest_scale"),
            (FlowConfig { patch_stride_px: 0, ..good() }, "patch_stride_px"),
            (FlowConfig { patch_stride_px: 9, ..good() }, "patch_stride_px"),
            (FlowConfig { descent_iterations: 0, ..good() }, "descent_iterations"),
            (FlowConfig { variational_iterations: 101, ..good() }, "variational_iterations"),
        ] {
            assert!(bad.validate().unwrap_err().to_string().contains(name));
        }
    }
}
