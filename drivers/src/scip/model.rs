//! The supported sensor models and their differences.

use core::f64::consts::TAU;
use core::fmt;

use hal::ScanGeometry;

use super::{Encoding, Mode, Parameters, RangeCodes, Request};

/// A family of sensors that this driver supports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// URG-04LX: 10 Hz, 240 degrees, USB or RS-232; starts in SCIP 1.1.
    #[serde(rename = "urg-04lx")]
    Urg04lx,
    /// UTM-30LX: 40 Hz, 270 degrees, USB. The Ethernet model UTM-30LX-EW reports the same name.
    #[default]
    #[serde(rename = "utm-30lx")]
    Utm30lx,
    /// UST-10LX: 40 Hz, 270 degrees, Ethernet.
    #[serde(rename = "ust-10lx")]
    Ust10lx,
    /// UST-20LX: as the UST-10LX with twice the range.
    #[serde(rename = "ust-20lx")]
    Ust20lx,
}

/// The properties of one family of sensors, from its data sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelSpec {
    /// The start of the name that the sensor reports (`MODL`).
    pub name: &'static str,
    /// The meaning of the measured numbers.
    pub codes: RangeCodes,
    /// Number of steps of a full revolution (`ARES`).
    pub steps_per_turn: u16,
    /// First step that is measured (`AMIN`).
    pub first_step: u16,
    /// Last step that is measured (`AMAX`).
    pub last_step: u16,
    /// The step that points straight ahead (`AFRT`).
    pub front_step: u16,
    /// Revolutions per minute (`SCAN`).
    pub rpm: u16,
    /// Shortest and longest distance according to the data sheet.
    pub range_m: (f32, f32),
    /// Largest error of a distance near the robot, metres.
    pub accuracy_m: f64,
    /// Whether the sensor starts in SCIP 1.1 and needs the command `SCIP2.0`, which it also accepts
    /// in SCIP 2. The command is not sent to other sensors: an unknown command may hang a sensor
    /// until it is switched off (<https://github.com/ros-drivers/urg_c/pull/4>, about the URG-04LX
    /// and requests for intensities).
    pub starts_in_scip_1: bool,
}

/// C-42-03320B, section 5 and the example of `PP`; data sheet URG-04LX: 20 to 5,600 mm, 100 ms, 10 mm up to 1 m; URG-04LX-UG01,
/// which reports the same name: 30 mm.
const URG_04LX: ModelSpec = ModelSpec {
    name: "URG-04LX",
    codes: RangeCodes::URG_04LX,
    steps_per_turn: 1024,
    first_step: 44,
    last_step: 725,
    front_step: 384,
    rpm: 600,
    range_m: (0.02, 5.6),
    accuracy_m: 0.03,
    starts_in_scip_1: true,
};

/// Data sheet UTM-30LX: 0.1 to 30 m, 270 degrees in steps of 0.25, 25 ms, 30 mm up to 10 m.
const UTM_30LX: ModelSpec = ModelSpec {
    name: "UTM-30LX",
    codes: RangeCodes::UTM_30LX,
    steps_per_turn: 1440,
    first_step: 0,
    last_step: 1080,
    front_step: 540,
    rpm: 2400,
    range_m: (0.1, 30.0),
    accuracy_m: 0.03,
    starts_in_scip_1: false,
};

/// Data sheet UST-10LX: 0.06 to 10 m, 40 mm, otherwise as the UTM-30LX.
const UST_10LX: ModelSpec = ModelSpec {
    name: "UST-10LX",
    codes: RangeCodes::UST_10LX,
    range_m: (0.06, 10.0),
    accuracy_m: 0.04,
    ..UTM_30LX
};

/// Data sheet UST-20LX: 0.06 to 20 m, otherwise as the UST-10LX.
const UST_20LX: ModelSpec =
    ModelSpec { name: "UST-20LX", codes: RangeCodes::UST_20LX, range_m: (0.06, 20.0), ..UST_10LX };

impl Model {
    pub const ALL: [Self; 4] = [Self::Urg04lx, Self::Utm30lx, Self::Ust10lx, Self::Ust20lx];

    #[must_use]
    pub fn spec(self) -> &'static ModelSpec {
        match self {
            Self::Urg04lx => &URG_04LX,
            Self::Utm30lx => &UTM_30LX,
            Self::Ust10lx => &UST_10LX,
            Self::Ust20lx => &UST_20LX,
        }
    }

    /// The geometry of the scans. For a sensor that is mounted upside down, the first beam is the
    /// sensor's last step.
    #[must_use]
    pub fn geometry(self, upside_down: bool) -> ScanGeometry {
        let spec = self.spec();
        let increment = TAU / f64::from(spec.steps_per_turn);
        let front_step = f64::from(spec.front_step);
        let first = if upside_down {
            front_step - f64::from(spec.last_step)
        } else {
            f64::from(spec.first_step) - front_step
        };
        ScanGeometry {
            angle_min_rad: first * increment,
            angle_increment_rad: increment,
            beams: self.request(0).beams(),
            range_min_m: spec.range_m.0,
            range_max_m: spec.range_m.1,
            period_ns: 60_000_000_000 / u64::from(spec.rpm),
            clockwise: upside_down,
        }
    }

    /// The request for continuous scans of all beams, with `skip` scans omitted between two.
    #[must_use]
    pub fn request(self, skip: u8) -> Request {
        let ModelSpec { first_step, last_step, .. } = *self.spec();
        Request {
            encoding: Encoding::Three,
            mode: Mode::Continuous { skip, scans: 0 },
            first_step,
            last_step,
            cluster: 1,
        }
    }
}

impl ModelSpec {
    /// Whether a sensor with these parameters is of this family. The rotation rate can be
    /// configured and is not compared.
    #[must_use]
    pub fn matches(&self, parameters: &Parameters<'_>) -> bool {
        parameters.model.starts_with(self.name)
            && parameters.steps_per_turn == u32::from(self.steps_per_turn)
            && parameters.first_step == u32::from(self.first_step)
            && parameters.last_step == u32::from(self.last_step)
            && parameters.front_step == u32::from(self.front_step)
    }
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.spec().name)
    }
}

/// The text does not name a supported model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("unknown LiDAR model; supported are urg-04lx, utm-30lx, ust-10lx and ust-20lx")]
pub struct UnknownModel;

impl core::str::FromStr for Model {
    type Err = UnknownModel;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|model| model.spec().name.eq_ignore_ascii_case(text))
            .ok_or(UnknownModel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_geometry_of_the_utm_30lx_is_that_of_its_data_sheet() {
        for upside_down in [false, true] {
            let geometry = Model::Utm30lx.geometry(upside_down);
            let sheet = ScanGeometry::UTM_30LX;
            assert!((geometry.angle_min_rad - sheet.angle_min_rad).abs() < 1e-12);
            assert!((geometry.angle_increment_rad - sheet.angle_increment_rad).abs() < 1e-12);
            assert_eq!((geometry.beams, geometry.period_ns), (sheet.beams, sheet.period_ns));
            assert_eq!(
                (geometry.range_min_m, geometry.range_max_m),
                (sheet.range_min_m, sheet.range_max_m)
            );
        }
    }

    #[test]
    fn mounting_upside_down_mirrors_the_beams() {
        for model in Model::ALL {
            let upright = model.geometry(false);
            let mirrored = model.geometry(true);
            for beam in 0..upright.beams {
                let angle_rad = mirrored.angle_rad(upright.beams - 1 - beam);
                assert!((upright.angle_rad(beam) + angle_rad).abs() < 1e-9, "{model}, beam {beam}");
            }
        }
    }

    #[test]
    fn the_urg_04lx_covers_239_degrees_ten_times_per_second() {
        let geometry = Model::Urg04lx.geometry(false);
        assert_eq!((geometry.beams, geometry.period_ns), (682, 100_000_000));
        // 681 steps of 360 / 1024 degrees.
        assert!(((geometry.angle_increment_rad * 681.0).to_degrees() - 239.4).abs() < 0.1);
    }

    #[test]
    fn model_names_are_parsed_in_either_case() {
        assert_eq!("ust-20LX".parse(), Ok(Model::Ust20lx));
        assert!("rplidar".parse::<Model>().unwrap_err().to_string().contains("utm-30lx"));
    }
}
