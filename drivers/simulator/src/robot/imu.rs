//! The simulated inertial measurement unit.

use std::convert::Infallible;
use std::sync::{Arc, Mutex};

use hal::{ErrorType, Imu, ImuSample};
use nalgebra::{UnitQuaternion, Vector3};
use rand_pcg::Pcg64Mcg;

use super::{State, lock};
use crate::error::SceneError;
use crate::random::normal;

const GRAVITY_MPS2: f64 = 9.81;
/// A person who carries the robot rotates it at this rate, rad/s. It is put down before that is over, because the simulated robot is carried
/// at once.
const CARRIED_RADPS: f64 = 2.0;
/// Samples that are older are lost when nothing has fetched them: the trail of true poses does not reach further back.
const KEPT_NS: u64 = 900_000_000;

/// How wrong an inertial measurement unit is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuNoise {
    /// Time between two samples.
    pub period_ns: u64,
    /// Standard deviation, over units, of the rate that it reports about each axis at rest, rad/s.
    pub bias_radps: f64,
    /// Change of that rate in one second, rad/s; it grows with the square root of the time.
    pub bias_walk_radps: f64,
    /// Standard deviation, over units, of the relative error of rates.
    pub scale: f64,
    /// Standard deviation of an integrated angle after one second, rad; it grows with the square root of the time.
    pub angle_rad: f64,
    /// Standard deviation of a specific force, m/s2.
    pub force_mps2: f64,
}

impl ImuNoise {
    /// A cheap unit, by the data sheet of the Bosch BMI160: 3 deg/s at rest and 1 % of scale at most, taken as twice the standard
    /// deviations of one axis; 0.007 deg/s per root hertz; 0.05 deg/s per degree of temperature, here one degree in five minutes;
    /// 180 µg per root hertz.
    pub const BMI160: Self = Self {
        period_ns: 10_000_000,
        bias_radps: 0.026,
        bias_walk_radps: 5e-5,
        scale: 0.005,
        angle_rad: 1.2e-4,
        force_mps2: 0.018,
    };

    pub(super) fn check(&self) -> Result<(), SceneError> {
        let fields =
            [self.bias_radps, self.bias_walk_radps, self.scale, self.angle_rad, self.force_mps2];
        let is_sound = fields.iter().all(|value| (0.0..=1.0).contains(value))
            && (1_000_000..=100_000_000).contains(&self.period_ns);
        if is_sound {
            return Ok(());
        }
        Err(SceneError::Option {
            option: "inertial measurement unit",
            value: format!("{self:?}"),
            allowed: "errors from 0 to 1, and a period from 1 to 100 ms",
        })
    }
}

/// The unit in the middle of the robot, with the axes of `base_link`. Each sample has the mean angular velocity of the time since the
/// one before it, and is stamped with the middle of that time. Its force is gravity alone: the simulated base changes its speed at
/// once, which no accelerometer measures sensibly.
pub struct SimImu {
    shared: Arc<Mutex<State>>,
    noise: ImuNoise,
    rng: Pcg64Mcg,
    bias_radps: Vector3<f64>,
    scale: Vector3<f64>,
    /// Number of periods whose samples have been returned or lost.
    returned: u64,
}

impl SimImu {
    pub(super) fn new(shared: Arc<Mutex<State>>, noise: ImuNoise, mut rng: Pcg64Mcg) -> Self {
        let bias_radps = noise.bias_radps * normals(&mut rng);
        let scale = Vector3::repeat(1.0) + noise.scale * normals(&mut rng);
        let returned = lock(&shared).now_ns / noise.period_ns;
        Self { shared, noise, rng, bias_radps, scale, returned }
    }

    fn measure(&mut self, motion: &Motion) -> ImuSample {
        let seconds = self.noise.period_ns as f64 * 1e-9;
        self.bias_radps += self.noise.bias_walk_radps * seconds.sqrt() * normals(&mut self.rng);
        let noise = self.noise.angle_rad / seconds.sqrt() * normals(&mut self.rng);
        let true_radps = motion.rotation.scaled_axis() / seconds;
        let measured = true_radps.component_mul(&self.scale) + self.bias_radps + noise;
        let up = motion.up * GRAVITY_MPS2 + self.noise.force_mps2 * normals(&mut self.rng);
        ImuSample {
            time_ns: motion.middle_ns,
            angular_radps: measured.into(),
            force_mps2: Some(up.into()),
        }
    }
}

impl ErrorType for SimImu {
    type Error = Infallible;
}

impl Imu for SimImu {
    fn poll_sample(&mut self) -> Result<Option<ImuSample>, Infallible> {
        let period_ns = self.noise.period_ns;
        let motion = {
            let mut state = lock(&self.shared);
            let complete = state.now_ns / period_ns;
            self.returned = self.returned.max(complete.saturating_sub(KEPT_NS / period_ns));
            if self.returned >= complete {
                return Ok(None);
            }
            let start_ns = self.returned * period_ns;
            self.returned += 1;
            state.motion_during(start_ns, period_ns)
        };
        Ok(Some(self.measure(&motion)))
    }
}

/// The true motion during one period.
struct Motion {
    middle_ns: u64,
    /// Rotation from the beginning to the end, in the axes of the robot.
    rotation: UnitQuaternion<f64>,
    /// The vertical direction in the axes of the robot, in the middle.
    up: Vector3<f64>,
}

impl State {
    fn motion_during(&mut self, start_ns: u64, period_ns: u64) -> Motion {
        let attitude = |time_ns: u64| self.floor.raise(&self.trail.at(time_ns as i64)).rotation;
        let middle_ns = start_ns + period_ns / 2;
        let rotation = attitude(start_ns).inverse() * attitude(start_ns + period_ns);
        let up = attitude(middle_ns).inverse() * Vector3::z();
        // A robot that was carried was rotated meanwhile, at a speed at which a person rotates it.
        let most_rad = CARRIED_RADPS * period_ns as f64 * 1e-9;
        let carried_rad = self.carried_rad.clamp(-most_rad, most_rad);
        self.carried_rad -= carried_rad;
        let carried = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), carried_rad);
        Motion { middle_ns, rotation: rotation * carried, up }
    }
}

fn normals(rng: &mut Pcg64Mcg) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}
