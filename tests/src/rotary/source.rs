//! What a rotating scanner measures.

use std::f64::consts::TAU;

use hal::Range;

/// Computes single measurements.
pub trait CircleSource: Send {
    /// What a scanner measures at this time (monotonic) in a direction of the `laser` frame,
    /// counter-clockwise from its x axis, radians.
    fn range(&mut self, time_ns: u64, angle_rad: f64) -> Range;
}

/// A room of 6 x 4 m in which a person walks around the scanner.
#[derive(Debug, Clone, Copy, Default)]
pub struct CircleRoom;

const HALF_LENGTH_M: f64 = 3.0;
const HALF_WIDTH_M: f64 = 2.0;
/// Distance of the walking person from the scanner, radius, and time of one round.
const WALKER_M: f64 = 1.5;
const WALKER_RADIUS_M: f64 = 0.2;
const WALK_S: f64 = 10.0;

impl CircleSource for CircleRoom {
    fn range(&mut self, time_ns: u64, angle_rad: f64) -> Range {
        let walker_rad = time_ns as f64 * 1e-9 / WALK_S * TAU;
        let (sin, cos) = angle_rad.sin_cos();
        let wall_m = (HALF_LENGTH_M / cos.abs()).min(HALF_WIDTH_M / sin.abs());
        let distance_m = walker(angle_rad - walker_rad).unwrap_or(wall_m).min(wall_m);
        Range::Hit(distance_m as f32)
    }
}

/// Distance of the person at a bearing, if the beam hits them.
fn walker(bearing_rad: f64) -> Option<f64> {
    let across = WALKER_M * bearing_rad.sin();
    let along = WALKER_M * bearing_rad.cos();
    let half = WALKER_RADIUS_M * WALKER_RADIUS_M - across * across;
    (half >= 0.0 && along > 0.0).then(|| along - half.sqrt())
}

/// Distance as the scanners send it, millimetres: 0 if there is none.
pub(crate) fn packet_mm(range: Range) -> u16 {
    match range {
        Range::Hit(distance_m) => (distance_m * 1000.0).round() as u16,
        Range::TooNear => 10,
        Range::NoReturn | Range::Error => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_room_shows_its_walls_and_the_walking_person() {
        let ranges_mm = [0.0_f64, 90.0, 180.0]
            .map(|degrees| packet_mm(CircleRoom.range(0, degrees.to_radians())));
        assert_eq!(ranges_mm, [1300, 2000, 3000]);
    }
}
