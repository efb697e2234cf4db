//! Configuration of the inertial measurement unit.

use std::path::Path;

use hal::ImuMount;

use super::ImuError;

hal::settings! {
    /// An inertial measurement unit, or a gyroscope alone, of Linux's Industrial I/O. It is optional.
    pub struct ImuConfig {
        /// Name of the unit, as `cat /sys/bus/iio/devices/*/name` shows it (`bmi160`, `lsm6dsox_gyro`, `gyro_3d`), its folder
        /// (`/sys/bus/iio/devices/iio:device0`), or `unix:PATH`, a socket of another program
        /// (docs/imu.md). Empty: the robot has none.
        device: String = String::new();
        /// Samples per second that the unit is asked for. It takes the nearest rate that it has. With fewer than 50, angles would be
        /// interrupted between two samples.
        rate_hz: f64 = 100.0, in 50.0..=1000.0, unit "Hz";
        /// Name of the IIO trigger that starts each measurement, for a unit that has none of its own.
        trigger: String = String::new();
        /// Without a sample for this long the unit counts as silent.
        timeout_ms: u32 = 100, in 10..=2000, unit "ms", source "10 samples at the default rate";
        /// Orientation on the robot: rotation about x (forward), the first of the three.
        roll_deg: f64 = 0.0, in -180.0..=180.0, unit "deg";
        /// Rotation about y (left), the second.
        pitch_deg: f64 = 0.0, in -180.0..=180.0, unit "deg";
        /// Rotation about z (up), the third.
        yaw_deg: f64 = 0.0, in -180.0..=180.0, unit "deg";
    }
}

/// Where the unit is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImuPlace<'a> {
    /// A device of the kernel, by its name.
    Name(&'a str),
    /// A device of the kernel, by its folder in sysfs.
    Folder(&'a Path),
    /// A simulated unit or another program, at a Unix stream socket.
    Socket(&'a Path),
}

/// Fewer periods than this within the time-out would make a silence of every late sample.
const LEAST_PERIODS: f64 = 2.0;

impl ImuConfig {
    /// The lowest rate with which angles are not interrupted between two samples, Hz: that of samples 50 ms apart, with room for late
    /// ones (`runtime::imu::ImuHistory`).
    pub(super) const LEAST_HZ: f64 = 50.0;

    /// Whether the robot has such a unit.
    #[must_use]
    pub fn is_used(&self) -> bool {
        !self.device.is_empty()
    }

    /// Where the unit is.
    #[must_use]
    pub fn place(&self) -> ImuPlace<'_> {
        match self.device.strip_prefix("unix:") {
            Some(path) => ImuPlace::Socket(Path::new(path)),
            None if self.device.contains('/') => ImuPlace::Folder(Path::new(&self.device)),
            None => ImuPlace::Name(&self.device),
        }
    }

    /// The unit's orientation on the robot.
    #[must_use]
    pub fn mount(&self) -> ImuMount {
        ImuMount { roll_deg: self.roll_deg, pitch_deg: self.pitch_deg, yaw_deg: self.yaw_deg }
    }

    /// The smallest `timeout_ms` for samples at this rate.
    #[must_use]
    pub fn least_timeout_ms(rate_hz: f64) -> u32 {
        (LEAST_PERIODS * 1000.0 / rate_hz).ceil() as u32
    }

    /// Checks every value, and the values together.
    ///
    /// # Errors
    /// [`ImuError::Config`] with the first value that is not allowed.
    pub fn validate(&self) -> Result<(), ImuError> {
        let refused = |what: String| Err(ImuError::Config { what });
        if let Err(error) = self.check_ranges() {
            return refused(error.to_string());
        }
        if let ImuPlace::Folder(path) | ImuPlace::Socket(path) = self.place()
            && !path.is_absolute()
        {
            return refused(format!(
                "`device = \"{}\"` has a path that does not begin with `/`: give the whole path",
                self.device
            ));
        }
        let least_ms = Self::least_timeout_ms(self.rate_hz);
        if self.timeout_ms < least_ms {
            return refused(format!(
                "`timeout_ms = {}` is shorter than two samples at {} Hz: raise it to {least_ms} or more",
                self.timeout_ms, self.rate_hz
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_has_no_unit_unless_it_is_configured() {
        let none: ImuConfig = toml::from_str("").unwrap();
        none.validate().unwrap();
        assert!(!none.is_used());
        assert_eq!(none.mount(), ImuMount::default());
    }

    #[test]
    fn a_unit_is_named_by_its_name_its_folder_or_its_socket() {
        let place = |device: &str| {
            let config = ImuConfig { device: device.to_owned(), ..ImuConfig::default() };
            config.validate().unwrap();
            format!("{:?}", config.place())
        };
        assert_eq!(place("bmi160"), "Name(\"bmi160\")");
        let folder = "/sys/bus/iio/devices/iio:device0";
        assert_eq!(place(folder), format!("Folder({folder:?})"));
        assert_eq!(place("unix:/run/imu"), "Socket(\"/run/imu\")");
    }

    #[test]
    fn a_value_that_is_not_allowed_is_refused_with_the_way_out() {
        for (text, answer) in [
            ("device = \"unix:imu\"", "give the whole path"),
            ("device = \"iio/device0\"", "give the whole path"),
            ("rate_hz = 25.0", "50.0 to 1000.0 Hz"),
            ("rate_hz = nan", "50.0 to 1000.0 Hz"),
            ("rate_hz = 60.0\ntimeout_ms = 20", "raise it to 34 or more"),
            ("timeout_ms = 0", "10 to 2000 ms"),
            ("yaw_deg = 181.0", "-180.0 to 180.0 deg"),
        ] {
            let config: ImuConfig = toml::from_str(text).unwrap();
            let said = config.validate().unwrap_err().to_string();
            assert!(said.contains(answer), "{text}: {said}");
        }
    }
}
