//! What can be wrong with what the map is given.

/// Why an observation or a configuration was refused. The map is as it was before.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// A pose holds NaN or infinity.
    #[error("{pose} is not finite: {value}; leave this observation out")]
    PoseNotFinite {
        /// Which pose.
        pose: &'static str,
        /// The pose as text.
        value: String,
    },
    /// A pose is further from the origin of `odom` than cells can be counted.
    #[error(
        "{pose} is {distance_m} m from the origin of odom, at most {limit_m} m can be mapped; restart the odometry"
    )]
    PoseOutOfReach {
        /// Which pose.
        pose: &'static str,
        /// Its distance from the origin.
        distance_m: f64,
        /// The largest distance allowed.
        limit_m: f64,
    },
    /// The camera looks straight up or down: it has no bearing in the plane.
    #[error("the camera's axis is within 6 degrees of vertical; check the camera mount")]
    CameraVertical,
    /// Depth, confidence and camera model are not of one size.
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
    /// The camera model cannot be a camera.
    #[error(
        "the camera model is not sound: size and focal lengths must be positive, all values finite"
    )]
    CameraModel,
    /// The scan has another number of ranges than its geometry says.
    #[error("the scan has {ranges} ranges for {beams} beams")]
    ScanShape {
        /// Number of ranges.
        ranges: usize,
        /// Number of beams.
        beams: usize,
    },
    /// A configuration value is out of range.
    #[error("{field} is {value}, allowed is {allowed}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range.
        allowed: &'static str,
    },
}
