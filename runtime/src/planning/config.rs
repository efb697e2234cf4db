//! How the robot likes to drive.

use serde::{Deserialize, Serialize};

/// A configuration value is out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field} is {value}, allowed is {allowed}")]
pub struct ConfigError {
    /// Name of the field.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// The allowed range.
    pub allowed: &'static str,
}

fn within(
    field: &'static str,
    value: f64,
    low: f64,
    high: f64,
    allowed: &'static str,
) -> Result<(), ConfigError> {
    // A NaN is in no range.
    if (low..=high).contains(&value) { Ok(()) } else { Err(ConfigError { field, value, allowed }) }
}

/// Where the robot fits, and what it would rather avoid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanConfig {
    /// Radius of the robot's round footprint, metres.
    pub footprint_radius_m: f64,
    /// Cells this much further from an obstacle than the footprint's radius are still never entered, metres.
    pub margin_m: f64,
    /// Up to this distance from an obstacle driving costs more, metres. The paper inflates by 8 cells of 0.03 m.
    pub inflation_radius_m: f64,
    /// Extra cost of a metre right at the hard limit, in metres of free floor; falls with the square of the distance.
    pub inflation_cost: f64,
    /// Cost of a metre through the unknown, in metres of free floor.
    pub unknown_cost: f64,
    /// Plans may leave the known part of the map by this much, metres.
    pub padding_m: f64,
    /// A search gives up after this many cells.
    pub max_expanded: usize,
}

impl Default for PlanConfig {
    fn default() -> Self {
        Self {
            footprint_radius_m: 0.12,
            margin_m: 0.02,
            inflation_radius_m: 0.24,
            inflation_cost: 4.0,
            unknown_cost: 4.0,
            padding_m: 0.6,
            max_expanded: 4_000_000,
        }
    }
}

impl PlanConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first value that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        within("footprint_radius_m", self.footprint_radius_m, 0.0, 1.0, "0 to 1")?;
        within("margin_m", self.margin_m, 0.0, 0.5, "0 to 0.5")?;
        within("inflation_radius_m", self.inflation_radius_m, 0.0, 1.0, "0 to 1")?;
        within("inflation_cost", self.inflation_cost, 0.0, 10.0, "0 to 10")?;
        within("unknown_cost", self.unknown_cost, 1.0, 10.0, "1 to 10")?;
        within("padding_m", self.padding_m, 0.0, 10.0, "0 to 10")?;
        within("max_expanded", self.max_expanded as f64, 1.0, 1e9, "1 to 1000000000")
    }
}

/// How a path becomes motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FollowerConfig {
    /// Length of one step forward, metres. The paper's action.
    pub forward_m: f64,
    /// Angle of one step of turning, radians. The paper's action: 2 degrees.
    pub turn_rad: f64,
    /// The robot steers for the point of the path this far ahead, metres.
    pub lookahead_m: f64,
    /// With more heading error than this it turns on the spot first, radians.
    pub turn_in_place_rad: f64,
    /// Turning on the spot ends below this heading error, radians.
    pub aligned_rad: f64,
    /// While driving, heading errors below this are not corrected, radians.
    pub correct_rad: f64,
    /// Larger ones are corrected on an arc, not on the spot: wheels with inertia lose most of their time by stopping.
    pub arcs: bool,
    /// The goal is reached within this distance, metres.
    pub goal_tolerance_m: f64,
    /// Further from the path than this is off the path, metres.
    pub off_path_m: f64,
}

impl Default for FollowerConfig {
    fn default() -> Self {
        let degree = core::f64::consts::PI / 180.0;
        Self {
            forward_m: 0.03,
            turn_rad: 2.0 * degree,
            lookahead_m: 0.3,
            turn_in_place_rad: 20.0 * degree,
            aligned_rad: 2.0 * degree,
            correct_rad: 4.0 * degree,
            arcs: false,
            goal_tolerance_m: 0.06,
            off_path_m: 0.3,
        }
    }
}

impl FollowerConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first value that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        within("forward_m", self.forward_m, 0.001, 0.5, "0.001 to 0.5")?;
        within("turn_rad", self.turn_rad, 0.001, 0.8, "0.001 to 0.8")?;
        within("lookahead_m", self.lookahead_m, self.forward_m, 5.0, "forward_m to 5")?;
        // Half a step is the best that a step can align to.
        within("aligned_rad", self.aligned_rad, self.turn_rad / 2.0, 1.0, "turn_rad / 2 to 1")?;
        within("correct_rad", self.correct_rad, self.aligned_rad, 1.0, "aligned_rad to 1")?;
        within(
            "turn_in_place_rad",
            self.turn_in_place_rad,
            self.correct_rad,
            3.0,
            "correct_rad to 3",
        )?;
        within("goal_tolerance_m", self.goal_tolerance_m, self.forward_m, 1.0, "forward_m to 1")?;
        within("off_path_m", self.off_path_m, self.forward_m, 5.0, "forward_m to 5")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed() {
        assert_eq!(PlanConfig::default().validate(), Ok(()));
        assert_eq!(FollowerConfig::default().validate(), Ok(()));
    }

    #[test]
    fn values_out_of_range_and_nan_are_refused_by_name() {
        let plan = PlanConfig { unknown_cost: f64::NAN, ..PlanConfig::default() };
        assert_eq!(plan.validate().map_err(|error| error.field), Err("unknown_cost"));
        let follower = FollowerConfig { aligned_rad: 0.01, ..FollowerConfig::default() };
        assert_eq!(follower.validate().map_err(|error| error.field), Err("aligned_rad"));
    }
}
