//! Configuration of an RPLIDAR.

use hal::ScanGeometry;

use super::{Model, ScanMode};
use crate::rotary::RotaryError;

hal::choices!(Model: "a1", "a2", "a3", "s2");
hal::choices!(ScanMode: "express", "standard");

hal::settings! {
    /// What only an RPLIDAR has.
    pub struct RplidarConfig {
        /// Model of the scanner. Another model is refused, because its motor and its limits differ.
        model: Model = Model::default();
        /// How measurements are sent. A standard scan has no checksum: a changed distance is not noticed. It is for firmware without express scans.
        scan_mode: ScanMode = ScanMode::default();
        /// Bit rate, if it differs from that of the model: 115200 (A1, A2), 256000 (A3, and A2M12), 1000000 (S2).
        baud: Option<u32> = None, in 9600..=4000000, unit "bit/s";
        /// Revolutions per second, if they differ from those of the model: 5.5 (A1), 10 (others). The S2 is set to it; of the others the robot only expects it. A slower scanner is a fault, and the robot drives slower by it.
        rotation_hz: Option<f64> = None, in 2.0..=20.0, unit "Hz";
    }
}

impl RplidarConfig {
    /// Bit rate of the port.
    #[must_use]
    pub fn baud(&self) -> u32 {
        self.baud.unwrap_or(self.model.spec().baud)
    }

    /// Revolutions per second.
    #[must_use]
    pub fn rotation_hz(&self) -> f64 {
        self.rotation_hz.unwrap_or(self.model.spec().rotation_hz)
    }

    /// The geometry of the scans.
    #[must_use]
    pub fn geometry(&self) -> ScanGeometry {
        self.model.geometry(self.scan_mode, self.rotation_hz())
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`RotaryError::Config`] with the value and its range.
    pub fn validate(&self) -> Result<(), RotaryError> {
        Ok(self.check_ranges()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_alone_is_a_complete_configuration() {
        let config: RplidarConfig = toml::from_str("model = \"s2\"").unwrap();
        assert_eq!((config.baud(), config.scan_mode), (1_000_000, ScanMode::Express));
        assert_eq!(config.geometry().period_ns, 100_000_000);
        let config: RplidarConfig = toml::from_str("rotation_hz = 7.0\nbaud = 256000").unwrap();
        assert_eq!((config.model, config.baud(), config.rotation_hz()), (Model::A1, 256_000, 7.0));
    }

    #[test]
    fn values_out_of_range_are_refused_with_the_range() {
        let config = RplidarConfig { rotation_hz: Some(1.0), ..RplidarConfig::default() };
        let error = config.validate().unwrap_err().to_string();
        assert!(error.contains("rotation_hz = 1") && error.contains("2.0 to 20.0 Hz"), "{error}");
    }
}
