//! What the scanner sees.

use drivers::scip::Model;

/// Where the ranges of a simulated scanner come from.
pub trait ScanSource: Send {
    /// What each step sees in a scan that is begun at `time_ns` (monotonic), millimetres, in the order of the sensor's steps
    /// (counter-clockwise from above, as [`Model::geometry`] has them). The sensor's error codes may be among them.
    fn ranges_mm(&mut self, time_ns: u64, out: &mut [u32]);
}

/// A room of 6 x 4 m with somebody walking around in it.
#[derive(Debug, Clone)]
pub struct Room {
    angles_rad: Vec<f64>,
}

const HALF_LENGTH_M: f64 = 3.0;
const HALF_WIDTH_M: f64 = 2.0;
/// Somebody's distance from the scanner, girth, and time for a turn around it.
const WALKER_M: f64 = 1.5;
const WALKER_RADIUS_M: f64 = 0.2;
const WALK_S: f64 = 10.0;

impl Room {
    /// As a model in the middle of the room sees it.
    #[must_use]
    pub fn new(model: Model) -> Self {
        let geometry = model.geometry(false);
        Self { angles_rad: (0..geometry.beams).map(|beam| geometry.angle_rad(beam)).collect() }
    }
}

impl ScanSource for Room {
    fn ranges_mm(&mut self, time_ns: u64, out: &mut [u32]) {
        let walker_rad = time_ns as f64 * 1e-9 / WALK_S * std::f64::consts::TAU;
        for (range, angle_rad) in out.iter_mut().zip(&self.angles_rad) {
            let (sin, cos) = angle_rad.sin_cos();
            let wall_m = (HALF_LENGTH_M / cos.abs()).min(HALF_WIDTH_M / sin.abs());
            let distance_m = walker(angle_rad - walker_rad).unwrap_or(wall_m).min(wall_m);
            *range = (distance_m * 1000.0).round() as u32;
        }
    }
}

/// Distance of a circle at a bearing, if the beam meets it.
fn walker(bearing_rad: f64) -> Option<f64> {
    let (across, along) = (WALKER_M * bearing_rad.sin(), WALKER_M * bearing_rad.cos());
    let half = WALKER_RADIUS_M * WALKER_RADIUS_M - across * across;
    (half >= 0.0 && along > 0.0).then(|| along - half.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_and_the_walker_are_where_they_are() {
        let mut ranges = vec![0; 1081];
        Room::new(Model::Utm30lx).ranges_mm(0, &mut ranges);
        assert_eq!(ranges[540], 1300, "the walker, ahead");
        assert_eq!(ranges[180], 2000, "the wall to the right, 90 degrees clockwise");
        assert_eq!(ranges[900], 2000, "the wall to the left");
    }
}
