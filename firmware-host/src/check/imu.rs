//! Tests the inertial measurement unit: that its samples come, and that gravity agrees with its mount.

use drivers::DeviceState;
use drivers::iio::{IioImu, ImuConfig, ImuSetup, QUEUE};
use hal::{Imu, ImuMount, ImuSample};
use nalgebra::Vector3;

use super::devices::{Finding, measure, state_of};

const IMU: &str = "IMU";
/// A mount that gravity contradicts by more than this is not the unit's. Floors slope by less.
const MOST_TILT_DEG: f64 = 5.0;
/// A robot that stands rotates by less than this, degrees per second: the worst bias of a cheap unit, and half as much again.
const MOST_RATE_DPS: f64 = 30.0;

/// Tests the unit; `None` if the robot has none.
pub fn test(config: &ImuConfig) -> Option<Finding> {
    let path = config.device.clone();
    let mut device = match IioImu::open(config) {
        Ok(device) => device?,
        Err(error) => {
            let state = state_of(&error);
            return Some(Finding::unusable(IMU, path, state, String::new(), error.to_string()));
        }
    };
    let mut mean = Mean::default();
    let measured = measure(|| {
        for _ in 0..QUEUE {
            let Ok(Some(sample)) = device.poll_sample() else { break };
            mean.add(&sample);
        }
        device.status()
    });
    let monitor = device.monitor();
    let setup = monitor.setup();
    if measured.status.state != DeviceState::Working {
        let starting = "it has not delivered a sample yet; check again".to_owned();
        let problem = monitor.problem().unwrap_or(starting);
        let details = setup.as_ref().map(ImuSetup::to_string).unwrap_or_default();
        return Some(Finding::unusable(IMU, path, measured.status.state, details, problem));
    }
    let details = format!(
        "{}; {:.1} samples per second; at rest {:.2} degrees per second about the vertical",
        setup.as_ref().map(ImuSetup::to_string).unwrap_or_default(),
        measured.rate_hz,
        mean.yaw_rate_dps(&config.mount())
    );
    let finding = Finding::usable(IMU, path, details);
    Some(finding.advise(mean.mount_advice(&config.mount())).advise(mean.rate_advice()))
}

/// Mean of the samples of a robot that stands.
#[derive(Default)]
struct Mean {
    count: f64,
    angular_radps: Vector3<f64>,
    force_mps2: Option<Vector3<f64>>,
}

impl Mean {
    fn add(&mut self, sample: &ImuSample) {
        self.count += 1.0;
        let share = 1.0 / self.count;
        self.angular_radps += share * (Vector3::from(sample.angular_radps) - self.angular_radps);
        self.force_mps2 = sample.force_mps2.map(|force| {
            let before = self.force_mps2.unwrap_or_default();
            before + share * (Vector3::from(force) - before)
        });
    }

    fn yaw_rate_dps(&self, mount: &ImuMount) -> f64 {
        self.angular_radps.dot(&mount.up()).to_degrees()
    }

    fn mount_advice(&self, mount: &ImuMount) -> Option<String> {
        let force = self.force_mps2.filter(|force| force.norm() > 1.0)?;
        let apart_deg = force.angle(&mount.up()).to_degrees();
        if apart_deg <= MOST_TILT_DEG {
            return None;
        }
        let found = ImuMount::of_force(force.into());
        Some(format!(
            "gravity is {apart_deg:.0} degrees away from where its mount says: if the robot stands level, set roll_deg = {:.0} and \
             pitch_deg = {:.0} in [devices.imu]",
            found.roll_deg, found.pitch_deg
        ))
    }

    fn rate_advice(&self) -> Option<String> {
        let rate_dps = self.angular_radps.norm().to_degrees();
        (rate_dps > MOST_RATE_DPS).then(|| {
            format!(
                "it rotates by {rate_dps:.0} degrees per second: check again while the robot stands"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(mount: ImuMount, rate_radps: f64) -> Mean {
        let mut mean = Mean::default();
        for index in 0..100 {
            let wobble = if index % 2 == 0 { 0.1 } else { -0.1 };
            let force = 9.81 * mount.up() + Vector3::repeat(wobble);
            mean.add(&ImuSample {
                time_ns: index,
                angular_radps: (rate_radps * mount.up()).into(),
                force_mps2: Some(force.into()),
            });
        }
        mean
    }

    #[test]
    fn a_unit_that_is_mounted_as_configured_needs_no_advice() {
        let mount = ImuMount { roll_deg: 180.0, pitch_deg: 3.0, yaw_deg: 40.0 };
        let mean = mean(mount, 0.01);
        assert_eq!(mean.mount_advice(&mount), None);
        assert_eq!(mean.rate_advice(), None);
        assert!((mean.yaw_rate_dps(&mount) - 0.573).abs() < 1e-3);
    }

    #[test]
    fn a_unit_on_its_side_is_told_its_mount() {
        let said = mean(ImuMount { roll_deg: 90.0, ..ImuMount::default() }, 0.0)
            .mount_advice(&ImuMount::default())
            .unwrap();
        assert!(said.contains("90 degrees away") && said.contains("roll_deg = 90"), "{said}");
    }

    #[test]
    fn a_gyroscope_alone_says_nothing_about_its_mount() {
        let mut mean = Mean::default();
        mean.add(&ImuSample { time_ns: 1, angular_radps: [0.0; 3], force_mps2: None });
        assert_eq!(mean.mount_advice(&ImuMount { roll_deg: 90.0, ..ImuMount::default() }), None);
    }

    #[test]
    fn a_robot_that_is_rotated_during_the_check_is_checked_again() {
        let said = mean(ImuMount::default(), 1.0).rate_advice().unwrap();
        assert!(said.contains("57 degrees per second"), "{said}");
    }
}
