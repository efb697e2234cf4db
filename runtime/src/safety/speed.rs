//! The speed from which the robot stops in time.
//!
//! A robot that drives at speed v covers v t until the wheels respond, with the reaction time t, and
//! v^2 / 2b until it stands, with the braking deceleration b. Both together must fit into the distance
//! that is free. A slow scanner has a long reaction time: an obstacle is known only some scans after it
//! appeared.

use super::{Footprint, SafetyConfig, Surroundings};

impl SafetyConfig {
    /// Distance from the command to stop until the robot stands still: reaction time and braking,
    /// metres.
    #[must_use]
    pub fn stopping_distance_m(&self, speed_mps: f64) -> f64 {
        speed_mps * self.reaction_s + speed_mps * speed_mps / (2.0 * self.brake_mps2)
    }

    /// The highest speed from which the robot still stops `stop_distance_m` before an obstacle that
    /// is `gap_m` ahead: the positive root v of v^2 / 2b + v t = d, with braking deceleration b,
    /// reaction time t and available distance d.
    #[must_use]
    pub fn speed_limit_mps(&self, gap_m: f64) -> f64 {
        let brake_mps2 = self.brake_mps2;
        let available_m = (gap_m - self.stop_distance_m).max(0.0);
        let lag_mps = brake_mps2 * self.reaction_s;
        (lag_mps * lag_mps + 2.0 * brake_mps2 * available_m).sqrt() - lag_mps
    }

    /// Distance straight ahead of the outline within which every obstacle is considered, metres.
    #[must_use]
    pub fn visible_ahead_m(&self) -> f64 {
        let footprint = Footprint::new(self.footprint_radius_m, &self.footprint_m);
        Surroundings::new(self).visible_ahead_m(&footprint)
    }

    /// The speed that the safety plane never exceeds: that from which the robot stops before an
    /// obstacle just beyond what is visible, m/s.
    #[must_use]
    pub fn top_speed_mps(&self) -> f64 {
        self.speed_limit_mps(self.visible_ahead_m())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_reaction(reaction_s: f64) -> SafetyConfig {
        SafetyConfig { reaction_s, brake_mps2: 1.0, ..SafetyConfig::default() }
    }

    #[test]
    fn from_the_top_speed_the_robot_stops_exactly_before_what_it_cannot_see() {
        for reaction_s in [0.05, 0.375, 0.66, 1.0] {
            let config = with_reaction(reaction_s);
            let stops_m = config.stopping_distance_m(config.top_speed_mps());
            let available_m = config.visible_ahead_m() - config.stop_distance_m;
            assert!((stops_m - available_m).abs() < 1e-9, "{reaction_s}: {stops_m}");
        }
    }

    #[test]
    fn a_longer_reaction_means_a_lower_top_speed() {
        let speeds =
            [0.05, 0.375, 0.66].map(|reaction_s| with_reaction(reaction_s).top_speed_mps());
        assert!(speeds[0] > speeds[1] && speeds[1] > speeds[2], "{speeds:?}");
    }
}
