//! `[run]` and `[devices]`: what only a real robot has.

use drivers::can::BaseConfig;
use drivers::iio::ImuConfig;
use drivers::lidar::LidarConfig;
use drivers::stop_line::StopLineConfig;
use drivers::v4l2::CameraDeviceConfig;
use hal::{CameraModel, Distortion};
use runtime::robot::{FRAME_TIMEOUT_S, SAFETY_HZ};
use runtime::safety::{SafetyConfig, needs_second_scan};

use super::Config;
use super::commissioning::Commissioning;

hal::settings! {
    /// The control loops of a real robot (`firmware-host run`).
    pub struct RunSection {
        /// Rate of the safety loop.
        safety_hz: f64 = SAFETY_HZ, in 10.0..=1000.0, unit "Hz";
        /// Real-time priority (SCHED_FIFO) of the safety thread, where the system permits it. 0 makes it an ordinary thread.
        realtime_priority: u8 = 40, in 0..=99;
        /// Whether the robot may move as soon as all devices work. Otherwise, and after a stop that needs a person, it waits for
        /// the signal SIGUSR1.
        arm_at_start: bool = true;
        /// How the numbers that the safety plane assumes (reaction, braking, roll-out, directions of wheels and scanner) are
        /// known. `measured`: `run` starts only beside a `commissioning.toml` of `check --drive` that bears them out. `by_hand`: a
        /// person measured them in another way, and answers for them. `unchecked`: on the bench, and in simulation.
        commissioning: Commissioning = Commissioning::Unchecked;
        /// File into which `check --drive` writes what it has measured. Empty: `commissioning.toml` beside the configuration.
        commissioning_file: String = String::new();
        /// Time from a LiDAR beam to the first response of the wheels. At least two periods of the scanner are assumed, and three
        /// of a scanner with few beams; `check` prints the speed that this allows, and `check --drive` measures the time.
        reaction_s: f64 = 0.1, in 0.0..=1.0, unit "s",
            source "two scans of a UTM-30LX, and 50 ms until the wheels respond";
        /// Deceleration of the base when it brakes. Measure it.
        brake_mps2: f64 = 1.0, in 0.1..=20.0, unit "m/s2";
        /// Consecutive valid scans that are needed before the robot drives.
        good_scans: u32 = 3, in 1..=100, unit "scans";
        /// The robot stops when the wheel feedback is older than this.
        feedback_timeout_s: f64 = 0.1, in 0.01..=1.0, unit "s";
        /// The robot does not follow a plan that is older than this.
        plan_timeout_s: f64 = 0.5, in 0.05..=2.0, unit "s";
        /// The robot stops when it has not received a camera frame for this long.
        frame_timeout_s: f64 = FRAME_TIMEOUT_S, in 0.1..=10.0, unit "s", was "picture_timeout_s";
        /// File that `firmware-host health` reads.
        status_file: String = "/run/embodied-depth/status.json".to_owned();
        /// File through which `firmware-host go-to`, `return` and `resume` give the running robot a task.
        task_file: String = "/run/embodied-depth/task.json".to_owned();
        /// Unix datagram socket on which another program sends poses, such as visual-inertial odometry or a motion capture.
        /// They replace the wheel odometry of localization. Empty: there is no such program.
        pose_socket: String = String::new();
        /// File that remembers a stop that needs a person, also when the program or the computer starts again.
        stop_file: String = "/var/lib/embodied-depth/last_stop.json".to_owned();
    }
}

hal::settings! {
    /// The devices of a real robot.
    pub struct DevicesSection {
        camera: CameraDeviceConfig;
        lens: LensSection;
        lidar: LidarConfig;
        base: BaseConfig;
        imu: ImuConfig;
        emergency_stop: StopLineConfig;
    }
}

hal::settings! {
    /// The camera's intrinsics at the size in `[devices.camera]`, from a calibration. The default is a pinhole with a field of
    /// view of 90 degrees at 640x480.
    pub struct LensSection {
        /// Horizontal focal length.
        fx: f64 = 320.0, in 1.0..=100000.0, unit "pixels";
        /// Vertical focal length.
        fy: f64 = 320.0, in 1.0..=100000.0, unit "pixels";
        /// Column of the optical axis; the centre of the first pixel is 0.
        cx: f64 = 319.5, in -100000.0..=100000.0, unit "pixels";
        /// Row of the optical axis; the centre of the first pixel is 0.
        cy: f64 = 239.5, in -100000.0..=100000.0, unit "pixels";
        /// Distortion as in OpenCV: `[]`, `[k1, k2, p1, p2, k3]` (plumb bob) or `[k1, k2, k3, k4]` (fisheye).
        distortion: Vec<f64> = Vec::new();
    }
}

impl DevicesSection {
    /// Intrinsics of the images that the camera delivers.
    ///
    /// # Errors
    /// A message for the user when there are neither zero, four nor five coefficients.
    pub fn camera_model(&self) -> Result<CameraModel, String> {
        let lens = &self.lens;
        let distortion = match lens.distortion[..] {
            [] => Distortion::None,
            [k1, k2, k3, k4] => Distortion::Fisheye([k1, k2, k3, k4]),
            [k1, k2, p1, p2, k3] => Distortion::PlumbBob([k1, k2, p1, p2, k3]),
            _ => {
                return Err(format!(
                    "`distortion` has {} numbers: give none, four (fisheye: k1 k2 k3 k4) or five (plumb bob: k1 k2 p1 p2 k3)",
                    lens.distortion.len()
                ));
            }
        };
        Ok(CameraModel {
            width: self.camera.width as usize,
            height: self.camera.height as usize,
            fx: lens.fx,
            fy: lens.fy,
            cx: lens.cx,
            cy: lens.cy,
            distortion,
        })
    }
}

impl Config {
    /// Scans that may pass until an obstacle that appears just behind a beam is known. It is measured one period later, at the
    /// end of that scan; where beams are few, a thin obstacle counts only in the second scan that shows it.
    #[must_use]
    pub fn scans_until_seen(&self) -> u32 {
        2 + u32::from(needs_second_scan(&self.devices.lidar.geometry()))
    }

    /// Time until an obstacle that appears just behind a beam of the configured scanner is known, seconds.
    #[must_use]
    pub fn sight_s(&self) -> f64 {
        let lidar = &self.devices.lidar;
        f64::from(self.scans_until_seen()) * lidar.longest_period_s() + lidar.arrival_s()
    }

    /// The safety plane's configuration for a real robot, whose wheels need time to stop and whose safety plane has its own
    /// rate.
    #[must_use]
    pub fn live_safety_config(&self) -> SafetyConfig {
        let run = &self.run;
        let lidar = &self.devices.lidar;
        // A silent scanner is detected within two of its periods, even if `scan_timeout_s` is longer.
        let two_scans_s = 2.0 * lidar.longest_period_s();
        SafetyConfig {
            lateral_margin_m: lidar.accuracy_m(),
            reaction_s: run.reaction_s.max(self.sight_s()),
            brake_mps2: run.brake_mps2,
            good_scans: run.good_scans,
            feedback_timeout_s: run.feedback_timeout_s,
            plan_timeout_s: run.plan_timeout_s,
            scan_timeout_s: self.safety.scan_timeout_s.min(two_scans_s) + lidar.late_s(),
            scan_late_s: lidar.late_s(),
            period_s: 1.0 / run.safety_hz,
            ..self.safety_config()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::lidar::LidarKind;
    use drivers::scip::Model;

    #[test]
    fn the_safety_plane_of_a_real_robot_has_the_brakes_and_the_rate_of_that_robot() {
        let mut config = Config::default();
        config.run.brake_mps2 = 0.4;
        config.run.safety_hz = 50.0;
        let live = config.live_safety_config();
        assert_eq!((live.brake_mps2, live.period_s, live.good_scans), (0.4, 0.02, 3));
        assert!(config.safety_config().brake_mps2 > 10.0, "a simulated base stops at once");
    }

    #[test]
    fn the_margin_beside_the_robot_is_the_accuracy_of_its_scanner_and_at_least_3_cm() {
        let mut config = Config::default();
        let margins_mm =
            |config: &Config| (1e3 * config.live_safety_config().lateral_margin_m).round();
        for (model, margin_mm) in [(Model::Utm30lx, 30.0), (Model::Ust10lx, 40.0)] {
            config.devices.lidar.model = model;
            assert_eq!(margins_mm(&config), margin_mm, "{model:?}");
        }
        config.devices.lidar.kind = LidarKind::Rplidar;
        assert_eq!(margins_mm(&config), 30.0);
        config.devices.lidar.kind = LidarKind::Ld06;
        assert_eq!(margins_mm(&config), 45.0);
    }

    #[test]
    fn the_reaction_time_is_never_shorter_than_two_periods_of_the_scanner() {
        let mut config = Config::default();
        for (model, reaction_s) in [(Model::Utm30lx, 0.1), (Model::Urg04lx, 0.2)] {
            config.devices.lidar.model = model;
            assert!(
                (config.live_safety_config().reaction_s - reaction_s).abs() < 1e-9,
                "{model:?}"
            );
        }
        config.run.reaction_s = 0.3;
        assert!((config.live_safety_config().reaction_s - 0.3).abs() < 1e-9);
    }

    #[test]
    fn a_slow_scanner_with_few_beams_means_a_longer_reaction_and_a_lower_speed() {
        let mut config = Config::default();
        let fast_mps = config.live_safety_config().top_speed_mps();
        config.devices.lidar.kind = LidarKind::Ld06;
        let ld06 = config.live_safety_config();
        // Three periods of 115 ms, and 30 ms of the cable.
        assert!((ld06.reaction_s - 0.375).abs() < 1e-9, "{}", ld06.reaction_s);
        assert!((ld06.scan_timeout_s - 0.2).abs() < 1e-9);
        config.devices.lidar.kind = LidarKind::Rplidar;
        let a1 = config.live_safety_config();
        assert!((a1.reaction_s - (3.0 * 1.15 / 5.5 + 0.03)).abs() < 1e-6, "{}", a1.reaction_s);
        assert!(a1.top_speed_mps() < ld06.top_speed_mps() && ld06.top_speed_mps() < fast_mps);
        config.devices.lidar.rplidar.model = drivers::rplidar::Model::S2;
        let s2 = config.live_safety_config();
        assert!((s2.reaction_s - 0.26).abs() < 1e-9, "two scans are enough with 1440 beams");
    }

    #[test]
    fn a_late_scanner_means_a_longer_reaction_and_no_silence() {
        let mut config = Config::default();
        config.run.reaction_s = 0.0;
        let exact = config.live_safety_config();
        config.devices.lidar.latency_ms = 40.0;
        let late = config.live_safety_config();
        assert!((late.reaction_s - exact.reaction_s - 0.04).abs() < 1e-9);
        assert!((late.scan_timeout_s - exact.scan_timeout_s - 0.04).abs() < 1e-9);
        assert!(late.top_speed_mps() < exact.top_speed_mps());
        config.devices.lidar.kind = LidarKind::Ld06;
        let on_a_cable_s = config.live_safety_config().reaction_s;
        assert!((on_a_cable_s - (0.375 + 0.04)).abs() < 1e-9, "{on_a_cable_s}");
    }
}
