//! Smallest and largest value of every number in the configuration.

use std::fmt;

/// What a number may be, ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limit {
    pub key: &'static str,
    pub min: f64,
    pub max: f64,
    pub unit: &'static str,
}

impl Limit {
    /// NaN is in no range.
    pub fn allows(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {} {}", self.min, self.max, self.unit)
    }
}

/// The limit of a key; `None` for keys that hold no number.
pub(super) fn of(key: &str) -> Option<&'static Limit> {
    LIMITS.iter().find(|limit| limit.key == key)
}

const fn limit(key: &'static str, min: f64, max: f64, unit: &'static str) -> Limit {
    Limit { key, min, max, unit }
}

pub(super) const LIMITS: &[Limit] = &[
    limit("camera.width", 64.0, 4096.0, "pixels"),
    limit("camera.height", 32.0, 4096.0, "pixels"),
    limit("camera.horizontal_fov_deg", 20.0, 150.0, "degrees"),
    limit("camera.height_m", 0.05, 3.0, "metres"),
    limit("camera.forward_m", -1.0, 1.0, "metres"),
    limit("camera.pitch_down_deg", -60.0, 60.0, "degrees"),
    limit("lidar.height_m", 0.02, 3.0, "metres"),
    limit("lidar.forward_m", -1.0, 1.0, "metres"),
    limit("base.footprint_radius_m", 0.05, 1.0, "metres"),
    limit("base.forward_step_m", 0.005, 0.5, "metres"),
    limit("base.turn_step_deg", 0.1, 30.0, "degrees"),
    limit("base.tick_ms", 5.0, 1000.0, "milliseconds"),
    limit("base.footprint_m", -1.0, 1.0, "metres"),
    limit("safety.stop_distance_m", 0.02, 2.0, "metres"),
    limit("safety.back_off_m", 0.0, 2.0, "metres"),
    limit("safety.blind_back_off_m", 0.0, 0.5, "metres"),
    limit("safety.rear_memory_s", 0.0, 300.0, "seconds"),
    limit("safety.back_off_timeout_s", 0.1, 60.0, "seconds"),
    limit("safety.scan_timeout_s", 0.02, 2.0, "seconds"),
    limit("coarse.min_depth_m", 0.05, 10.0, "metres"),
    limit("coarse.max_depth_m", 0.5, 100.0, "metres"),
    limit("coarse.parallax_px", 0.5, 200.0, "pixels"),
    limit("coarse.turn_error", 0.0, 1.0, "of the turn"),
    limit("coarse.turn_error_floor_rad", 0.0, 0.1, "radians"),
    limit("coarse.parallax_over_error", 0.0, 100.0, "times the error"),
    limit("coarse.min_baseline_m", 0.001, 1.0, "metres"),
    limit("coarse.max_baseline_m", 0.01, 10.0, "metres"),
    limit("coarse.min_overlap", 0.0, 1.0, "of the picture"),
    limit("coarse.keyframe_step_m", 0.001, 1.0, "metres"),
    limit("coarse.keyframe_turn_rad", 0.001, 1.0, "radians"),
    limit("coarse.keyframes", 1.0, 256.0, "keyframes"),
    limit("coarse.max_step_m", 0.01, 10.0, "metres"),
    limit("coarse.max_turn_rad", 0.01, 3.2, "radians"),
    limit("coarse.penalty_small", 0.0, 200.0, "of 96"),
    limit("coarse.penalty_large", 0.0, 1000.0, "of 96"),
    limit("coarse.memory", 0.0, 0.99, "of the evidence"),
    limit("coarse.vote_weights", -100.0, 100.0, "each"),
    limit("coarse.belief_weights", -100.0, 100.0, "each"),
    limit("coarse.min_remembered", 0.0, 1.0, "of the picture"),
    limit("coarse.min_confidence", 0.0, 0.99, "probability of being right"),
    limit("map.cell_m", 0.005, 1.0, "metres"),
    limit("map.side_cells", 16.0, 4096.0, "cells"),
    limit("map.recenter_cells", 0.0, 2048.0, "cells"),
    limit("map.occupied_increment", 0.001, 1000.0, "log-odds"),
    limit("map.free_decrement", 0.001, 1000.0, "log-odds"),
    limit("map.decay", 0.5, 1.0, "of the log-odds"),
    limit("map.limit", 1.0, 1e6, "log-odds"),
    limit("map.band_min_m", 0.0, 2.0, "metres"),
    limit("map.band_max_m", 0.0, 2.5, "metres"),
    limit("map.mark_range_m", 0.1, 20.0, "metres"),
    limit("map.clear_range_m", 0.1, 20.0, "metres"),
    limit("map.clear_margin", 0.0, 0.9, "of the distance"),
    limit("map.min_confidence", 0.0, 1.0, "probability of being right"),
    limit("map.stride_u", 1.0, 64.0, "columns"),
    limit("map.stride_v", 1.0, 64.0, "rows"),
    limit("map.min_points", 1.0, 1000.0, "pixels"),
    limit("map.outlier_share", 0.0, 0.49, "of the points"),
    limit("map.over_the_top_weight", 0.0, 1.0, "of a full look"),
    limit("map.lidar_range_m", 0.1, 30.0, "metres"),
    limit("map.collision_width_m", 0.0, 2.0, "metres"),
    limit("map.collision_log_odds", 0.001, 1e6, "log-odds"),
    limit("map.collision_updates", 1.0, 1e9, "updates"),
    limit("planning.margin_m", 0.0, 0.5, "metres"),
    limit("planning.inflation_radius_m", 0.0, 1.0, "metres"),
    limit("planning.inflation_cost", 0.0, 10.0, "metres"),
    limit("planning.unknown_cost", 1.0, 10.0, "metres"),
    limit("planning.padding_m", 0.0, 10.0, "metres"),
    limit("planning.max_expanded", 1.0, 1e9, "cells"),
    limit("planning.lookahead_m", 0.01, 5.0, "metres"),
    limit("planning.turn_in_place_deg", 1.0, 170.0, "degrees"),
    limit("planning.aligned_deg", 0.1, 57.0, "degrees"),
    limit("planning.correct_deg", 0.1, 57.0, "degrees"),
    limit("planning.goal_tolerance_m", 0.01, 1.0, "metres"),
    limit("planning.off_path_m", 0.01, 5.0, "metres"),
    limit("exploration.warm_up_frames", 0.0, 1e7, "frames"),
    limit("exploration.frontier_frames", 1.0, 1e6, "frames"),
    limit("exploration.inconsistency_frames", 1.0, 1e6, "frames"),
    limit("exploration.inconsistency_gap", 1.0, 1000.0, "frames"),
    limit("exploration.goal_reached_m", 0.05, 5.0, "metres"),
    limit("exploration.progress_timeout_s", 1.0, 3600.0, "seconds"),
    limit("exploration.goal_timeout_s", 1.0, 3600.0, "seconds"),
    limit("exploration.trips_per_goal", 1.0, 1000.0, "trips"),
    limit("exploration.blacklist_expiry_s", 1.0, 86400.0, "seconds"),
    limit("exploration.blacklist_radius_m", 0.0, 10.0, "metres"),
    limit("exploration.replan_ticks", 1.0, 1000.0, "ticks"),
    limit("exploration.doubtful_log_odds", 0.0, 1000.0, "log-odds"),
    limit("network.threads", 1.0, 256.0, "threads"),
    limit("models.max_p99_ms", 1.0, 10_000.0, "milliseconds"),
    limit("models.gate_memory_mib", 256.0, 1_048_576.0, "MiB"),
    limit("models.gate_timeout_s", 1.0, 86_400.0, "seconds"),
    limit("models.trial_turns", 10.0, 1e6, "turns"),
    limit("models.trial_m", 0.0, 1000.0, "metres"),
    limit("recording.segment_s", 1.0, 3600.0, "seconds"),
    limit("recording.segment_mib", 1.0, 4096.0, "MiB"),
    limit("recording.depth_every_ticks", 1.0, 1e6, "ticks"),
    limit("recording.map_every_ticks", 1.0, 1e6, "ticks"),
    limit("recording.quota_gib", 0.0, 1e6, "GiB"),
    limit("recording.free_gib", 0.0, 1e6, "GiB"),
    limit("simulator.odometry_distance_noise", 0.0, 0.2, "of the distance"),
    limit("simulator.odometry_turn_noise", 0.0, 0.2, "of the turn"),
    limit("simulator.lidar_noise_m", 0.0, 0.2, "metres"),
    limit("simulator.lidar_dropout", 0.0, 0.5, "of the beams"),
    limit("simulator.nuisances.exposure_drift_stops", 0.0, 4.0, "stops"),
    limit("simulator.nuisances.exposure_drift_period_s", 0.1, 1e6, "seconds"),
    limit("simulator.nuisances.flicker", 0.0, 1.0, "of the light"),
    limit("simulator.nuisances.flicker_hz", 0.0, 1e5, "Hz"),
    limit("simulator.nuisances.sun_patches", 0.0, 4.0, "times white"),
    limit("simulator.nuisances.sensor_noise", 0.0, 64.0, "of 255"),
    limit("simulator.nuisances.shutter_s", 0.0, 1.0, "seconds"),
    limit("simulator.nuisances.people", 0.0, 32.0, "people"),
    limit("run.safety_hz", 10.0, 1000.0, "turns a second"),
    limit("run.realtime_priority", 0.0, 99.0, "(0: none)"),
    limit("run.reaction_s", 0.0, 1.0, "seconds"),
    limit("run.brake_mps2", 0.1, 20.0, "m/s2"),
    limit("run.good_scans", 1.0, 100.0, "scans"),
    limit("run.feedback_timeout_s", 0.01, 1.0, "seconds"),
    limit("run.plan_timeout_s", 0.05, 2.0, "seconds"),
    limit("run.picture_timeout_s", 0.1, 10.0, "seconds"),
];
