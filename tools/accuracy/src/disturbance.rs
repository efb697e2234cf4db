//! What spoils frames and poses on a real robot.

use hal::Pose3;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::sequence::View;

/// Frames between two changes of exposure.
const EXPOSURE_PERIOD: usize = 7;

/// One thing that goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disturbance {
    /// Nothing does.
    None,
    /// Every few frames the exposure jumps by 15 % and 4 grey levels, and back.
    Exposure,
    /// Every pose is off by 2 mm and 2 mrad (standard deviation along and about each axis), each frame anew.
    Pose,
}

impl Disturbance {
    /// All of the table.
    pub const ALL: [Self; 3] = [Self::None, Self::Exposure, Self::Pose];

    /// Its name in the table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Exposure => "exposure x1.15 + 4",
            Self::Pose => "pose 2 mm, 2 mrad",
        }
    }

    /// The frame and the pose that the engine gets of the frame with this index.
    #[must_use]
    pub fn of(self, index: usize, view: &View) -> (Vec<u8>, Pose3) {
        let brighter = self == Self::Exposure && (index / EXPOSURE_PERIOD) % 2 == 1;
        let expose = |value: &u8| {
            if brighter { (f32::from(*value) * 1.15 + 4.0).min(255.0) as u8 } else { *value }
        };
        let pose =
            if self == Self::Pose { noisy(index, &view.t_odom_camera) } else { view.t_odom_camera };
        (view.rgb.iter().map(expose).collect(), pose)
    }
}

fn noisy(index: usize, pose: &Pose3) -> Pose3 {
    let mut random = Pcg64Mcg::seed_from_u64(index as u64);
    let mut normal = |sigma: f64| {
        // Box and Muller 1958.
        let a: f64 = random.random_range(f64::MIN_POSITIVE..1.0);
        let b: f64 = random.random();
        sigma * (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    };
    let mut vector = |sigma: f64| Vector3::new(normal(sigma), normal(sigma), normal(sigma));
    let shift = vector(0.002);
    let turn = vector(0.002);
    pose * Pose3::from_parts(Translation3::from(shift), UnitQuaternion::from_scaled_axis(turn))
}
