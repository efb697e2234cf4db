//! A view of the localized log from above: the hits of its scans, and the path.

use hal::Pose2;

use crate::report::canvas::{Canvas, Font};
use crate::report::colors::{Rgb, time};

use super::log::Log;

/// Longest side of the image.
const SIDE_PX: f64 = 1600.0;
const MARGIN_PX: f64 = 30.0;
/// Hits per square that make it as dark as it gets. A square is a pixel.
const DARK: u16 = 12;
/// Hits further away than this are drawn too coarsely to be of use.
const DRAWN_RANGE_M: f32 = 20.0;
const PAPER: Rgb = [255; 3];
const INK: Rgb = [40, 44, 52];

/// Where metres are drawn.
struct View {
    x_min_m: f64,
    y_max_m: f64,
    pixels_per_m: f64,
    width: usize,
    height: usize,
}

impl View {
    /// All points are inside, with a margin.
    fn around(points: &[[f64; 2]]) -> Self {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for point in points {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let [width_m, height_m] = [0, 1].map(|axis| (high[axis] - low[axis]).max(1.0));
        let pixels_per_m = ((SIDE_PX - 2.0 * MARGIN_PX) / width_m.max(height_m)).min(100.0);
        let [width, height] = [width_m, height_m]
            .map(|metres| (metres * pixels_per_m + 2.0 * MARGIN_PX).ceil() as usize);
        Self { x_min_m: low[0], y_max_m: high[1], pixels_per_m, width, height }
    }

    fn pixel(&self, point: [f64; 2]) -> [f64; 2] {
        [
            (point[0] - self.x_min_m) * self.pixels_per_m + MARGIN_PX,
            (self.y_max_m - point[1]) * self.pixels_per_m + MARGIN_PX,
        ]
    }
}

/// Draws the hits of every scan and the path through `poses`, which has one pose per line.
pub(super) fn draw(log: &Log, poses: &[Pose2]) -> Canvas {
    let hits = hits(log, poses);
    let path: Vec<[f64; 2]> = poses.iter().map(|pose| [pose.x_m, pose.y_m]).collect();
    let view = View::around(&[hits.as_slice(), path.as_slice()].concat());
    let mut canvas = Canvas::new(view.width as u32, view.height as u32, PAPER);
    draw_hits(&mut canvas, &view, &hits);
    let last = path.len().saturating_sub(2).max(1) as f64;
    for (index, ends) in path.windows(2).enumerate() {
        let color = time(index as f64 / last);
        canvas.line(view.pixel(ends[0]), view.pixel(ends[1]), 1.5, color, 0.9);
    }
    draw_scale(&mut canvas, &view);
    canvas
}

fn hits(log: &Log, poses: &[Pose2]) -> Vec<[f64; 2]> {
    let mut hits = Vec::new();
    for (line, pose) in log.lines.iter().zip(poses) {
        let Some(ranges) = &line.ranges else { continue };
        let t_map_laser = pose.compose(&log.t_base_laser);
        for (beam, range) in ranges.iter().enumerate() {
            let Some(range_m) = range.hit_m().filter(|range_m| *range_m < DRAWN_RANGE_M) else {
                continue;
            };
            let (sin, cos) = log.geometry.angle_rad(beam).sin_cos();
            let range_m = f64::from(range_m);
            let (x_m, y_m) = t_map_laser.transform(range_m * cos, range_m * sin);
            hits.push([x_m, y_m]);
        }
    }
    hits
}

fn draw_hits(canvas: &mut Canvas, view: &View, hits: &[[f64; 2]]) {
    let mut counts = vec![0_u16; view.width * view.height];
    for hit in hits {
        let [x, y] = view.pixel(*hit).map(|pixel| pixel.round() as usize);
        if let Some(count) = counts.get_mut(y * view.width + x).filter(|_| x < view.width) {
            *count = count.saturating_add(1);
        }
    }
    for (index, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let opacity = 0.15 + 0.85 * f64::from((*count).min(DARK)) / f64::from(DARK);
        let [x, y] = [index % view.width, index / view.width].map(|pixel| pixel as i64);
        canvas.blend(x, y, INK, opacity);
    }
}

fn draw_scale(canvas: &mut Canvas, view: &View) {
    let y = view.height as f64 - 0.5 * MARGIN_PX;
    let end = MARGIN_PX + 5.0 * view.pixels_per_m;
    canvas.line([MARGIN_PX, y], [end, y], 2.0, INK, 1.0);
    canvas.text(end as i64 + 8, y as i64 - 9, "5 m", Font::Label, INK);
}

#[cfg(test)]
mod tests {
    use super::super::log::{Line, Odometry};
    use super::*;
    use hal::{Range, ScanGeometry};

    #[test]
    fn a_hit_is_drawn_where_the_beam_ended() {
        let geometry = ScanGeometry { beams: 1, angle_min_rad: 0.0, ..ScanGeometry::UTM_30LX };
        let log = Log {
            geometry,
            t_base_laser: Pose2::IDENTITY,
            sweep_ns: 0,
            wheels: None,
            odometry: Odometry::Lines,
            lines: vec![line(None), line(Some(vec![Range::Hit(2.0)]))],
            other_shape: 0,
        };
        let facing_left = Pose2::new(1.0, 0.0, std::f64::consts::FRAC_PI_2);
        assert!(hits(&log, &[Pose2::IDENTITY, facing_left])[0][1] > 1.999);
        let canvas = draw(&log, &[Pose2::IDENTITY, facing_left]);
        // The view spans 1 x 2 m at 100 pixels per metre; the hit is in its upper right corner.
        assert_ne!(canvas.get(130, 30), Some(PAPER));
        assert_eq!(canvas.get(80, 30), Some(PAPER));
    }

    fn line(ranges: Option<Vec<Range>>) -> Line {
        Line { time_s: 1.0, wheel: Pose2::IDENTITY, ranges }
    }
}
