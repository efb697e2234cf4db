//! Range sources of simulated scanners.

use drivers::scip::Model;

/// Computes the ranges of a simulated scanner.
pub trait ScanSource: Send {
    /// Ranges of all steps of a scan that begins at `time_ns` (monotonic), millimetres, in the
    /// order of the sensor's steps (counter-clockwise from above, as in [`Model::geometry`]). They
    /// may include the sensor's error codes.
    fn ranges_mm(&mut self, time_ns: u64, out: &mut [u32]);
}

/// A room of 6 x 4 m in which a person walks around the scanner.
#[derive(Debug, Clone)]
pub struct Room {
    angles_rad: Vec<f64>,
}

const HALF_LENGTH_M: f64 = 3.0;
const HALF_WIDTH_M: f64 = 2.0;
/// Distance of the walking person from the scanner, radius, and time of one round.
const WALKER_M: f64 = 1.5;
const WALKER_RADIUS_M: f64 = 0.2;
const WALK_S: f64 = 10.0;

impl Room {
    /// The room as seen by a scanner of this model in its middle.
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

/// Distance of the person at a bearing, if the beam hits them.
fn walker(bearing_rad: f64) -> Option<f64> {
    let across = WALKER_M * bearing_rad.sin();
    let along = WALKER_M * bearing_rad.cos();
    let half = WALKER_RADIUS_M * WALKER_RADIUS_M - across * across;
    (half >= 0.0 && along > 0.0).then(|| along - half.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_show_the_walls_and_the_walking_person() {
        let mut ranges = vec![0; 1081];
        Room::new(Model::Utm30lx).ranges_mm(0, &mut ranges);
        assert_eq!(ranges[540], 1300, "the walker, ahead");
        assert_eq!(ranges[180], 2000, "the wall to the right, 90 degrees clockwise");
        assert_eq!(ranges[900], 2000, "the wall to the left");
    }
}
