//! Where the robot may drive, what it avoids, and how a path becomes motion.

use hal::RobotDescription;
use hal::settings::OutOfRange;

/// A value of the planner's or the follower's configuration is not allowed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field} is {value}, allowed is {allowed}")]
pub struct ConfigError {
    /// Name of the field.
    pub field: &'static str,
    /// The refused value.
    pub value: f64,
    /// The values that are allowed.
    pub allowed: &'static str,
}

impl From<OutOfRange> for ConfigError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self { field: key, value, allowed }
    }
}

hal::settings! {
    /// Path costs, search, and how a path becomes motion.
    pub struct PlanningSection {
        /// The planner keeps this distance between the footprint and obstacles.
        margin_m: f64 = 0.02, in 0.0..=0.5, unit "m";
        /// The planner keeps this distance in addition from stairs down: drops that fill at least 5 x 5 cells. No other sensor sees them.
        drop_margin_m: f64 = 0.3, in 0.0..=0.5, unit "m", source "a tread, the first of which the depth does not always show";
        /// Driving costs more where the robot's centre is nearer to an obstacle than this. Choose about 0.25 m more than the radius
        /// of the footprint.
        inflation_radius_m: f64 = 0.4, in 0.0..=1.0, unit "m", source "table tops seem up to 5 cm smaller than they are";
        /// Additional cost of a metre right beside an obstacle, in metres of free floor. It falls with the square of the
        /// distance.
        inflation_cost: f64 = 4.0, in 0.0..=10.0, unit "m";
        /// Cost of a metre through unknown space, in metres of free floor.
        unknown_cost: f64 = 4.0, in 1.0..=10.0, unit "m";
        /// Distance by which a path may leave the known part of the map.
        padding_m: f64 = 0.6, in 0.0..=10.0, unit "m";
        /// Areas that no path enters, each a list of corners in `map`, such as `[[[1.0, 0.0], [2.0, 0.0], [2.0, 1.0]]]`.
        /// `--keep-out FILE` adds those of a GeoJSON file.
        keep_out_m: Vec<Vec<[f64; 2]>> = Vec::new(), in -1000.0..=1000.0, unit "m";
        /// Areas that no path leaves, in the same form; none: the robot may drive anywhere. `--keep-in FILE` adds those of a GeoJSON
        /// file.
        keep_in_m: Vec<Vec<[f64; 2]>> = Vec::new(), in -1000.0..=1000.0, unit "m";
        /// A search gives up after it has expanded this many cells.
        max_expanded: usize = 4_000_000, in 1..=1000000000, unit "cells";
        /// The robot steers for the point of the path that is this far ahead.
        lookahead_m: f64 = 0.3, in 0.01..=5.0, unit "m";
        /// With a larger heading error, the robot first rotates in place.
        turn_in_place_deg: f64 = 20.0, in 1.0..=170.0, unit "degrees";
        /// Rotating in place ends below this heading error.
        aligned_deg: f64 = 2.0, in 0.1..=57.0, unit "degrees";
        /// While driving, smaller heading errors are not corrected.
        correct_deg: f64 = 4.0, in 0.1..=57.0, unit "degrees";
        /// Whether the robot corrects its heading on an arc. If not, it stops and rotates in place for every correction, as in
        /// the paper, and wheels with inertia lose most of their time by stopping.
        arcs: bool = true;
        /// The end of a path is reached within this distance.
        goal_tolerance_m: f64 = 0.06, in 0.01..=1.0, unit "m";
        /// Further from the path than this, the robot plans a new one.
        off_path_m: f64 = 0.3, in 0.01..=5.0, unit "m";
    }
}

impl PlanningSection {
    /// The planner's configuration for this robot.
    #[must_use]
    pub fn plan_config(&self, robot: &RobotDescription) -> PlanConfig {
        PlanConfig {
            footprint_radius_m: robot.footprint_radius_m,
            margin_m: self.margin_m,
            drop_margin_m: self.drop_margin_m,
            inflation_radius_m: self.inflation_radius_m,
            inflation_cost: self.inflation_cost,
            unknown_cost: self.unknown_cost,
            padding_m: self.padding_m,
            keep_out_m: self.keep_out_m.clone(),
            keep_in_m: self.keep_in_m.clone(),
            max_expanded: self.max_expanded,
        }
    }

    /// The follower's configuration for this robot.
    #[must_use]
    pub fn follower_config(&self, robot: &RobotDescription) -> FollowerConfig {
        FollowerConfig {
            forward_m: robot.forward_step_m,
            turn_rad: robot.turn_step_deg.to_radians(),
            lookahead_m: self.lookahead_m,
            turn_in_place_rad: self.turn_in_place_deg.to_radians(),
            aligned_rad: self.aligned_deg.to_radians(),
            correct_rad: self.correct_deg.to_radians(),
            arcs: self.arcs,
            goal_tolerance_m: self.goal_tolerance_m,
            off_path_m: self.off_path_m,
        }
    }
}

/// Where the robot fits, and what it avoids. [`PlanningSection`] describes the values.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanConfig {
    /// Radius of the circle that the planner keeps free of obstacles.
    pub footprint_radius_m: f64,
    pub margin_m: f64,
    pub drop_margin_m: f64,
    pub inflation_radius_m: f64,
    pub inflation_cost: f64,
    pub unknown_cost: f64,
    pub padding_m: f64,
    /// Areas that no path enters: corners in `map`.
    pub keep_out_m: Vec<Vec<[f64; 2]>>,
    /// Areas that no path leaves; none: it may go anywhere.
    pub keep_in_m: Vec<Vec<[f64; 2]>>,
    pub max_expanded: usize,
}

impl Default for PlanConfig {
    fn default() -> Self {
        PlanningSection::default().plan_config(&RobotDescription::default())
    }
}

impl PlanConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first value that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        // The configuration allows 0.05 to 1 m; tests also plan for a point.
        if !(0.0..=1.0).contains(&self.footprint_radius_m) {
            return Err(ConfigError {
                field: "footprint_radius_m",
                value: self.footprint_radius_m,
                allowed: "0 to 1 m",
            });
        }
        let section = PlanningSection {
            margin_m: self.margin_m,
            drop_margin_m: self.drop_margin_m,
            inflation_radius_m: self.inflation_radius_m,
            inflation_cost: self.inflation_cost,
            unknown_cost: self.unknown_cost,
            padding_m: self.padding_m,
            keep_out_m: self.keep_out_m.clone(),
            keep_in_m: self.keep_in_m.clone(),
            max_expanded: self.max_expanded,
            ..PlanningSection::default()
        };
        Ok(section.check_ranges()?)
    }
}

/// How a path becomes motion. [`PlanningSection`] describes the values.
#[derive(Debug, Clone, PartialEq)]
pub struct FollowerConfig {
    /// Length of one forward action.
    pub forward_m: f64,
    /// Angle of one rotation action.
    pub turn_rad: f64,
    pub lookahead_m: f64,
    pub turn_in_place_rad: f64,
    pub aligned_rad: f64,
    pub correct_rad: f64,
    pub arcs: bool,
    pub goal_tolerance_m: f64,
    pub off_path_m: f64,
}

impl Default for FollowerConfig {
    fn default() -> Self {
        PlanningSection::default().follower_config(&RobotDescription::default())
    }
}

fn within(
    field: &'static str,
    value: f64,
    low: f64,
    high: f64,
    allowed: &'static str,
) -> Result<(), ConfigError> {
    // No range contains NaN.
    if (low..=high).contains(&value) { Ok(()) } else { Err(ConfigError { field, value, allowed }) }
}

impl FollowerConfig {
    /// Checks every value against the length and angle of one action.
    ///
    /// # Errors
    /// Names the first value that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        within("forward_m", self.forward_m, 0.001, 0.5, "0.001 to 0.5")?;
        within("turn_rad", self.turn_rad, 0.001, 0.8, "0.001 to 0.8")?;
        within("lookahead_m", self.lookahead_m, self.forward_m, 5.0, "forward_m to 5")?;
        // A robot that rotates in steps can align to half a step at best.
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

    #[test]
    fn the_planner_has_the_same_footprint_as_the_safety_plane() {
        let safety = crate::safety::SafetyConfig::default();
        assert_eq!(PlanConfig::default().footprint_radius_m, safety.footprint_radius_m);
    }
}
