//! Errors of the occupancy map.

/// Why an observation or a configuration was refused. The map is unchanged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// A pose holds NaN or infinity.
    #[error("{pose} is not finite: {value}; leave this observation out")]
    PoseNotFinite {
        /// Name of the pose.
        pose: &'static str,
        value: String,
    },
    /// A pose is too far from the origin of `odom` for cell indices and f32 metres.
    #[error(
        "{pose} is {distance_m} m from the origin of odom, at most {limit_m} m can be mapped; restart the odometry"
    )]
    PoseOutOfReach {
        /// Name of the pose.
        pose: &'static str,
        distance_m: f64,
        limit_m: f64,
    },
    /// The camera's optical axis is nearly vertical, so it has no heading in the plane.
    #[error("the camera's axis is within 6 degrees of vertical; check the camera mount")]
    CameraVertical,
    /// Depth, confidence and camera model have different sizes.
    #[error(
        "depth is {depth:?}, confidence has {confidence} values, the camera model is {camera:?}: they must agree"
    )]
    SizeMismatch {
        /// Columns and rows of the depth.
        depth: (usize, usize),
        /// Number of confidence values.
        confidence: usize,
        /// Columns and rows of the camera model.
        camera: (usize, usize),
    },
    /// The camera model is invalid.
    #[error(
        "the camera model is invalid: size and focal lengths must be positive, all values finite"
    )]
    CameraModel,
    /// The number of ranges in the scan differs from the number of beams of its geometry.
    #[error("the scan has {ranges} ranges for {beams} beams")]
    ScanShape { ranges: usize, beams: usize },
    /// A configuration value is out of range.
    #[error("{field} is {value}, allowed is {allowed}")]
    Config {
        /// Name of the configuration field.
        field: &'static str,
        value: f64,
        /// The allowed range as text.
        allowed: &'static str,
    },
}
