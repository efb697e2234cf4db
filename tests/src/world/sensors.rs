//! The scanner's and the camera's view of the home.

use hal::{CameraModel, DepthMap, LaserScan, Pose3, Range};
use rand_pcg::Pcg64Mcg;
use simulator::nuisance::Nuisances;
use simulator::render::Lighting;
use simulator::robot::SimLidar;

use super::{Home, ScannerModel};
use crate::hokuyo::ScanSource;
use crate::rotary::CircleSource;
use crate::video::ImageSource;

/// The scanner's view. Its revolutions have their own times, and every beam sees the home as it was when it was measured.
pub(super) struct HomeScanner {
    pub lidar: SimLidar,
    pub model: ScannerModel,
    /// Time 0 of the home on the monotonic clock.
    pub start_ns: u64,
    pub scan: LaserScan,
}

impl ScanSource for HomeScanner {
    fn ranges_mm(&mut self, time_ns: u64, out: &mut [u32]) {
        let ScannerModel::Hokuyo(model) = self.model else { return };
        let codes = model.spec().codes;
        let nothing = codes.no_return.unwrap_or(codes.dmax_mm + 1);
        let near = codes.too_near.first().copied().unwrap_or(0);
        self.lidar.scan_from(time_ns.saturating_sub(self.start_ns), &mut self.scan);
        for (out, range) in out.iter_mut().zip(&self.scan.ranges) {
            *out = match range {
                Range::Hit(metres) => (metres * 1000.0).round() as u32,
                Range::NoReturn => nothing,
                Range::TooNear => near,
                Range::Error => 0,
            };
        }
    }
}

impl CircleSource for HomeScanner {
    fn range(&mut self, time_ns: u64, angle_rad: f64) -> Range {
        self.lidar.beam(time_ns.saturating_sub(self.start_ns), angle_rad)
    }
}

pub(super) struct HomeCamera {
    pub home: Home,
    pub model: CameraModel,
    pub t_base_camera: Pose3,
    /// Delay between exposure and timestamp.
    pub late_ns: u64,
    /// Disturbances of the images; only the sensor's noise is simulated here.
    pub nuisances: Nuisances,
    pub rng: Pcg64Mcg,
    pub rgb: Vec<u8>,
    pub depth: DepthMap,
}

impl ImageSource for HomeCamera {
    fn render(&mut self, _time_ns: u64, width: usize, height: usize, yuyv: &mut [u8]) {
        let at = self.home.pose_ago(self.late_ns).to_pose3() * self.t_base_camera;
        let camera = if (width, height) == (self.model.width, self.model.height) {
            self.model
        } else {
            self.model.resized(width, height)
        };
        let renderer = self.home.world().renderer();
        renderer.render(&camera, &at, &[], &Lighting::default(), &mut self.rgb, &mut self.depth);
        self.nuisances.add_sensor_noise(&mut self.rng, &mut self.rgb);
        for (pair, out) in self.rgb.chunks_exact(6).zip(yuyv.chunks_exact_mut(4)) {
            out.copy_from_slice(&yuyv_of(pair));
        }
    }
}

/// Two RGB pixels as Y U Y V, ITU-R BT.601 with limited range, as USB cameras send them.
fn yuyv_of(pair: &[u8]) -> [u8; 4] {
    let [r0, g0, b0, r1, g1, b1] =
        [0, 1, 2, 3, 4, 5].map(|index| f32::from(pair.get(index).copied().unwrap_or(0)));
    let r = (r0 + r1) / 2.0;
    let g = (g0 + g1) / 2.0;
    let b = (b0 + b1) / 2.0;
    let u = 128.0 + (-37.797 * r - 74.203 * g + 112.0 * b) / 255.0;
    let v = 128.0 + (112.0 * r - 93.786 * g - 18.214 * b) / 255.0;
    [luma(r0, g0, b0), u, luma(r1, g1, b1), v].map(|value| value.round() as u8)
}

fn luma(r: f32, g: f32, b: f32) -> f32 {
    16.0 + (65.481 * r + 128.553 * g + 24.966 * b) / 255.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_white_and_red_have_the_values_of_the_standard() {
        assert_eq!(yuyv_of(&[0; 6]), [16, 128, 16, 128]);
        assert_eq!(yuyv_of(&[255; 6]), [235, 128, 235, 128]);
        assert_eq!(yuyv_of(&[255, 0, 0, 255, 0, 0]), [81, 90, 81, 240]);
    }
}
