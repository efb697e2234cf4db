//! The speed that the safety plane allows with the configured scanner and brakes.

use std::fmt::Write as _;

use runtime::safety::SafetyConfig;

use crate::config::Config;

/// What limits the robot's speed.
pub struct Speed {
    safety: SafetyConfig,
    /// The speed that the planner asks for, m/s.
    asked_mps: f64,
    reaction: String,
}

impl Speed {
    pub fn new(config: &Config) -> Self {
        let asked_mps = config.base.speed_mps().min(config.devices.base.limits.linear_mps);
        Self { safety: config.live_safety_config(), asked_mps, reaction: reaction(config) }
    }

    /// The speed limit and its reason.
    pub fn sentence(&self) -> String {
        let Self { safety, asked_mps, reaction } = self;
        let top_mps = safety.top_speed_mps();
        let why = format!(
            "it considers obstacles up to {:.2} m ahead, keeps {:.2} m, {reaction}, and brakes with {:.1} m/s2 (run.brake_mps2)",
            safety.visible_ahead_m(),
            safety.stop_distance_m,
            safety.brake_mps2
        );
        if top_mps < *asked_mps {
            return format!(
                "the robot asks for {asked_mps:.2} m/s, and the safety plane slows it to {top_mps:.2} m/s: {why}"
            );
        }
        format!(
            "the robot drives {asked_mps:.2} m/s at most, and the safety plane would allow {top_mps:.2} m/s: {why}"
        )
    }
}

/// Where the reaction time comes from.
fn reaction(config: &Config) -> String {
    let lidar = &config.devices.lidar;
    let reaction_s = config.live_safety_config().reaction_s;
    let mut text = format!("reacts within {reaction_s:.2} s");
    let scans = config.scans_until_seen();
    let ms = 1e3 * lidar.longest_period_s();
    let configured_s = config.run.reaction_s;
    // Writing into a string cannot fail.
    _ = if configured_s >= reaction_s {
        write!(text, " (run.reaction_s)")
    } else {
        write!(text, " ({scans} scans of the {}, {ms:.0} ms each at most", lidar.name())
    };
    if configured_s < reaction_s {
        let cable_ms = 1e3 * lidar.arrival_s();
        text += &if cable_ms > 0.0 {
            format!(", and {cable_ms:.0} ms until they arrive)")
        } else {
            ")".to_owned()
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::lidar::LidarKind;

    #[test]
    fn the_speed_and_its_reason_are_named_for_each_scanner() {
        let mut config = Config::default();
        let text = Speed::new(&config).sentence();
        assert!(text.starts_with("the robot drives 0.30 m/s at most"), "{text}");
        assert!(text.contains("reacts within 0.10 s (run.reaction_s)"), "{text}");
        config.devices.lidar.kind = LidarKind::Rplidar;
        let text = Speed::new(&config).sentence();
        assert!(
            text.contains(
                "3 scans of the RPLIDAR A1, 209 ms each at most, and 30 ms until they arrive"
            ),
            "{text}"
        );
    }

    #[test]
    fn a_robot_that_asks_for_more_than_is_safe_is_told_how_much_it_gets() {
        let mut config = Config::default();
        config.base.forward_step_m = 0.3;
        config.devices.base.limits.linear_mps = 3.0;
        config.devices.lidar.kind = LidarKind::Rplidar;
        let text = Speed::new(&config).sentence();
        let top_mps = config.live_safety_config().top_speed_mps();
        assert!(top_mps < 1.2);
        assert!(
            text.starts_with(&format!(
                "the robot asks for 3.00 m/s, and the safety plane slows it to {top_mps:.2} m/s"
            )),
            "{text}"
        );
    }
}
