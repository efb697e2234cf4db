//! A path of waypoints that something walks back and forth.

/// Straight lines between waypoints, world frame, metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    waypoints_m: Vec<[f64; 2]>,
    /// Path length up to each waypoint, metres.
    reached_m: Vec<f64>,
}

/// Where something is on its path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub position_m: [f64; 2],
    /// Heading along the path, radians.
    pub yaw_rad: f64,
}

impl Path {
    /// `None` without waypoints or when a number is not finite.
    pub fn new(waypoints_m: Vec<[f64; 2]>) -> Option<Self> {
        if waypoints_m.is_empty() || !waypoints_m.iter().flatten().all(|c| c.is_finite()) {
            return None;
        }
        let mut reached_m = vec![0.0];
        for pair in waypoints_m.windows(2) {
            let step = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
            reached_m.push(reached_m[reached_m.len() - 1] + step);
        }
        Some(Self { waypoints_m, reached_m })
    }

    /// Length from the first waypoint to the last, metres.
    pub fn length_m(&self) -> f64 {
        self.reached_m[self.reached_m.len() - 1]
    }

    /// The place after walking `walked_m` from the first waypoint, back and forth.
    pub fn after(&self, walked_m: f64) -> Place {
        let length = self.length_m();
        // Walking back and forth is a triangle wave of the path length.
        let lap = if length > 0.0 { walked_m.rem_euclid(2.0 * length) } else { 0.0 };
        let (along, backwards) =
            if lap <= length { (lap, false) } else { (2.0 * length - lap, true) };
        let segment = self
            .reached_m
            .partition_point(|&r| r <= along)
            .clamp(1, self.reached_m.len().max(2) - 1);
        let from = self.waypoints_m[segment - 1];
        let to = self.waypoints_m.get(segment).copied().unwrap_or(from);
        let step = [to[0] - from[0], to[1] - from[1]];
        let share =
            (along - self.reached_m[segment - 1]) / step[0].hypot(step[1]).max(f64::MIN_POSITIVE);
        let heading = if backwards { [-step[0], -step[1]] } else { step };
        Place {
            position_m: [from[0] + share * step[0], from[1] + share * step[1]],
            yaw_rad: heading[1].atan2(heading[0]),
        }
    }
}
