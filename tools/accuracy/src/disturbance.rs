//! Disturbances of frames and poses as they occur on a real robot.

use hal::Pose3;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::sequence::View;

/// Frames between two changes of exposure.
const EXPOSURE_PERIOD: usize = 7;

/// A disturbance of frames or poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disturbance {
    None,
    /// Every [`EXPOSURE_PERIOD`] frames the exposure changes by 15 % and 4 grey levels, and back.
    Exposure,
    /// Every pose has an independent error of 2 mm and 2 mrad (standard deviation along and about each axis).
    Pose,
    /// Twice that error of the pose, changes of the exposure, and noise of 5 grey levels; for fits only.
    Rough,
}

impl Disturbance {
    /// The disturbances of the table, in its order.
    pub const ALL: [Self; 3] = [Self::None, Self::Exposure, Self::Pose];

    /// Its name in the table; empty without a disturbance.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Exposure => "exposure x1.15 + 4",
            Self::Pose => "pose 2 mm, 2 mrad",
            Self::Rough => "rough",
        }
    }

    /// The disturbed image and pose of the frame with this index.
    #[must_use]
    pub fn apply(self, index: usize, view: &View) -> (Vec<u8>, Pose3) {
        let changes = matches!(self, Self::Exposure | Self::Rough);
        let mut rgb = match changes && (index / EXPOSURE_PERIOD) % 2 == 1 {
            true => view.rgb.iter().map(|byte| brighten(*byte)).collect(),
            false => view.rgb.clone(),
        };
        if self == Self::Rough {
            add_noise(index, &mut rgb);
        }
        let pose = match self {
            Self::None | Self::Exposure => view.t_odom_camera,
            Self::Pose => noisy(index, &view.t_odom_camera, 0.002),
            Self::Rough => noisy(index, &view.t_odom_camera, 0.004),
        };
        (rgb, pose)
    }
}

fn brighten(byte: u8) -> u8 {
    (f32::from(byte) * 1.15 + 4.0).min(255.0) as u8
}

/// Adds noise of 5 grey levels (standard deviation): the sum of four random bytes is nearly normal, with one of 147.8.
fn add_noise(index: usize, rgb: &mut [u8]) {
    let mut random = Pcg64Mcg::seed_from_u64(index as u64);
    for byte in rgb {
        let sum: u16 = random.random::<u32>().to_le_bytes().into_iter().map(u16::from).sum();
        let noise = (f32::from(sum) - 510.0) * (5.0 / 147.8);
        *byte = (f32::from(*byte) + noise).round().clamp(0.0, 255.0) as u8;
    }
}

/// With errors of `deviation` metres and radians.
fn noisy(index: usize, pose: &Pose3, deviation: f64) -> Pose3 {
    let mut random = Pcg64Mcg::seed_from_u64(index as u64);
    let shift = Vector3::from_fn(|_, _| normal(&mut random, deviation));
    let rotation = Vector3::from_fn(|_, _| normal(&mut random, deviation));
    let noise =
        Pose3::from_parts(Translation3::from(shift), UnitQuaternion::from_scaled_axis(rotation));
    pose * noise
}

/// A normally distributed number (Box and Muller 1958).
fn normal(random: &mut Pcg64Mcg, sigma: f64) -> f64 {
    let a: f64 = random.random_range(f64::MIN_POSITIVE..1.0);
    let b: f64 = random.random();
    sigma * (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}
