//! Errors of localization.

/// Why localization refused its configuration or an input. Nothing has changed then.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LocalizationError {
    /// A value of the configuration is out of range.
    #[error("`localization.{key} = {value}` is not allowed: it must be {allowed}")]
    Config {
        /// Name of the key.
        key: &'static str,
        value: f64,
        /// The allowed range.
        allowed: &'static str,
    },
    /// The scanner cannot be used for localization.
    #[error(
        "a scanner with {beams} beams {increment_rad} rad apart cannot localize: it must have 8 to 100000 beams less than 0.2 rad apart"
    )]
    Scanner { beams: usize, increment_rad: f64 },
    /// The pose of the scanner on the robot is not finite.
    #[error("the pose of the scanner on the robot is not finite: {value}; check the mount")]
    Mount { value: String },
}
