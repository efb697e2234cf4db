//! Settings of [`DenseFlow`](super::DenseFlow).

use serde::{Deserialize, Serialize};

/// How much work is done: the presets of OpenCV's `DISOpticalFlow`, with its names. At each, errors are lower and time is less
/// than OpenCV's (`cargo xtask bench "optical flow"`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowPreset {
    /// Searches at a quarter of the image's size, with one iteration of refinement.
    UltraFast,
    /// Searches at a quarter of the image's size, with variational refinement.
    Fast,
    /// Searches at half of the image's size with patches closer together, and variational refinement.
    Medium,
}

/// Settings of [`DenseFlow`](super::DenseFlow). Patches are 8x8 pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlowConfig {
    /// The finest scale that is searched: 0 is the full image, 1 half its size, up to 4.
    pub finest_scale: usize,
    /// Distance from one patch to the next, pixels of the scale, 1 to 8.
    pub patch_stride_px: usize,
    /// Maximum number of gradient descent steps for each patch and scale.
    pub descent_iterations: usize,
    /// Iterations of the variational refinement at each scale; 0 turns it off.
    pub variational_iterations: usize,
}

impl From<FlowPreset> for FlowConfig {
    /// The numbers are those that OpenCV documents for its presets, except for the iterations of the refinement (0, 5 and 5
    /// there): ours are cheap enough for more.
    fn from(preset: FlowPreset) -> Self {
        let (finest_scale, patch_stride_px, descent_iterations, variational_iterations) =
            match preset {
                FlowPreset::UltraFast => (2, 4, 12, 1),
                FlowPreset::Fast => (2, 4, 16, 6),
                FlowPreset::Medium => (1, 3, 25, 7),
            };
        Self { finest_scale, patch_stride_px, descent_iterations, variational_iterations }
    }
}

impl Default for FlowConfig {
    fn default() -> Self {
        FlowPreset::Medium.into()
    }
}

/// Why flow cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FlowError {
    #[error("flow: {field} = {value} is out of range; allowed: {allowed}")]
    Setting { field: &'static str, value: usize, allowed: &'static str },
    /// An image has another size than the [`DenseFlow`](super::DenseFlow) was made for.
    #[error(
        "flow: {what} is {width}x{height}, {want_width}x{want_height} is needed; resample it, or make a DenseFlow of its size"
    )]
    Size { what: &'static str, width: usize, height: usize, want_width: usize, want_height: usize },
    #[error("flow: {what} is a {format:?} image; convert it to RGB8 or GRAY8")]
    Format { what: &'static str, format: hal::PixelFormat },
}

impl FlowError {
    /// Refuses a `size` (columns, rows) other than `want`.
    pub(super) fn check_size(
        what: &'static str,
        size: (usize, usize),
        want: (usize, usize),
    ) -> Result<(), Self> {
        let (width, height) = size;
        let (want_width, want_height) = want;
        if size == want {
            Ok(())
        } else {
            Err(Self::Size { what, width, height, want_width, want_height })
        }
    }
}

impl FlowConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the field, its value and the allowed range.
    pub fn validate(&self) -> Result<(), FlowError> {
        require("finest_scale", self.finest_scale, 0..=4, "0 to 4")?;
        require("patch_stride_px", self.patch_stride_px, 1..=super::PATCH, "1 to 8")?;
        require("descent_iterations", self.descent_iterations, 1..=1000, "1 to 1000")?;
        require("variational_iterations", self.variational_iterations, 0..=100, "0 to 100")
    }
}

fn require(
    field: &'static str,
    value: usize,
    range: std::ops::RangeInclusive<usize>,
    allowed: &'static str,
) -> Result<(), FlowError> {
    if range.contains(&value) { Ok(()) } else { Err(FlowError::Setting { field, value, allowed }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_are_sound() {
        for preset in [FlowPreset::UltraFast, FlowPreset::Fast, FlowPreset::Medium] {
            assert_eq!(FlowConfig::from(preset).validate(), Ok(()));
        }
    }

    #[test]
    fn impossible_values_are_refused_by_name() {
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
