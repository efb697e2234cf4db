//! Settings of the flow engine.

use serde::{Deserialize, Serialize};

/// How much work the engine does: the presets of OpenCV's `DISOpticalFlow`, with its names. At each, errors are lower and time is
/// less than OpenCV's (`cargo xtask bench "optical flow"`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowPreset {
    /// Quarter-size patches, hardly any refinement.
    UltraFast,
    /// Quarter-size patches, variational refinement.
    Fast,
    /// Half-size patches, closer together, variational refinement.
    Medium,
}

/// Settings of [`DenseFlow`](super::DenseFlow). Patches are 8x8 pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlowConfig {
    /// The finest scale that is looked at: 0 is the full picture, 1 half its size, ... 4.
    pub finest_scale: usize,
    /// From one patch to the next, pixels of the scale, 1 to 8.
    pub patch_stride_px: usize,
    /// Steps of gradient descent for each patch and scale, at most.
    pub descent_iterations: usize,
    /// Iterations of the variational refinement at each scale; 0 refines nothing.
    pub variational_iterations: usize,
}

impl From<FlowPreset> for FlowConfig {
    /// The numbers are those that OpenCV documents for its presets, but for the iterations of the refinement (0, 5 and 5): ours
    /// are cheap enough for more.
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

/// The flow cannot be computed like this.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FlowError {
    /// An impossible setting.
    #[error("flow: {field} = {value} is impossible; allowed: {allowed}")]
    Setting {
        /// The field.
        field: &'static str,
        /// Its value.
        value: usize,
        /// What it may be.
        allowed: &'static str,
    },
    /// A picture or a field has another size than the engine was made for.
    #[error(
        "flow: {what} is {width}x{height}, {want_width}x{want_height} is needed; resample it or make an engine of its size"
    )]
    Size {
        /// What has the wrong size.
        what: &'static str,
        /// Its columns.
        width: usize,
        /// Its rows.
        height: usize,
        /// Columns of the engine.
        want_width: usize,
        /// Rows of the engine.
        want_height: usize,
    },
    /// A picture's format is not understood.
    #[error("flow: {what} is a {format:?} picture; convert it to RGB8 or GRAY8")]
    Format {
        /// Which picture.
        what: &'static str,
        /// Its format.
        format: hal::PixelFormat,
    },
}

impl FlowError {
    /// Refuses a `size` (columns, rows) that is not the wanted one.
    pub(super) fn check_size(
        what: &'static str,
        size: (usize, usize),
        want: (usize, usize),
    ) -> Result<(), Self> {
        let ((width, height), (want_width, want_height)) = (size, want);
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
    /// Names the field, its value and what it may be.
    pub fn validate(&self) -> Result<(), FlowError> {
        let require = |field, value, sound: bool, allowed| {
            if sound { Ok(()) } else { Err(FlowError::Setting { field, value, allowed }) }
        };
        require("finest_scale", self.finest_scale, self.finest_scale <= 4, "0 to 4")?;
        let stride = (1..=super::PATCH).contains(&self.patch_stride_px);
        require("patch_stride_px", self.patch_stride_px, stride, "1 to 8")?;
        let descent = (1..=1000).contains(&self.descent_iterations);
        require("descent_iterations", self.descent_iterations, descent, "1 to 1000")?;
        let variational = self.variational_iterations <= 100;
        require("variational_iterations", self.variational_iterations, variational, "0 to 100")
    }
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
