//! What was found about one parameter, and whether it can be believed.

use std::fmt;

/// One parameter of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parameter {
    LeftRadius,
    RightRadius,
    Track,
    LidarForward,
    LidarLeft,
    LidarYaw,
    LidarLatency,
    CameraRoll,
    CameraPitch,
    CameraYaw,
    CameraForward,
    CameraLeft,
    CameraHeight,
    CameraLatency,
    FocalLength,
}

/// How a parameter is shown and judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nature {
    /// Name for people.
    pub name: &'static str,
    /// Key of the configuration; `None` for what is only a check.
    pub key: Option<&'static str>,
    pub unit: &'static str,
    pub decimals: usize,
    /// A standard deviation above this is not a measurement.
    pub needed_sigma: f64,
    /// A larger change is more likely an error of the wiring or of the configuration than of a tape measure.
    pub largest_change: f64,
    /// The motion that shows the parameter.
    pub motion: &'static str,
    /// What a wrong value does.
    pub effect: &'static str,
}

const ROTATE: &str = "rotate by several full revolutions, in both directions";
const STRAIGHT: &str = "drive straight for several metres";
const STOP_AND_GO: &str = "start and stop rotations often";

impl Parameter {
    /// Its name, key, unit and limits.
    #[must_use]
    pub fn nature(self) -> Nature {
        match self {
            Self::LeftRadius => {
                scale("left wheel's radius scale", "devices.base.left_radius_scale")
            }
            Self::RightRadius => {
                scale("right wheel's radius scale", "devices.base.right_radius_scale")
            }
            Self::Track => Nature {
                needed_sigma: 0.01,
                largest_change: 0.1,
                motion: ROTATE,
                effect: "every rotation by the wheels",
                ..metres("track", "devices.base.track_m")
            },
            Self::LidarForward => {
                Nature { motion: ROTATE, ..metres("LiDAR, forward of the axle", "lidar.forward_m") }
            }
            Self::LidarLeft => {
                Nature { motion: ROTATE, ..metres("LiDAR, left of the middle", "lidar.left_m") }
            }
            Self::LidarYaw => Nature {
                motion: STRAIGHT,
                largest_change: 30.0,
                effect: "where scans are put into the map while it drives",
                ..degrees("LiDAR's yaw", "lidar.yaw_deg")
            },
            Self::LidarLatency => Nature {
                key: Some("devices.lidar.latency_ms"),
                largest_change: 200.0,
                effect: "where scans are put into the map while it rotates, and how fast the robot may drive",
                ..milliseconds("LiDAR's latency")
            },
            Self::CameraRoll => {
                Nature { motion: ROTATE, ..degrees("camera's roll", "camera.roll_deg") }
            }
            Self::CameraPitch => {
                Nature { motion: ROTATE, ..degrees("camera's pitch down", "camera.pitch_down_deg") }
            }
            Self::CameraYaw => {
                Nature { motion: STRAIGHT, ..degrees("camera's yaw", "camera.yaw_deg") }
            }
            Self::CameraForward => Nature {
                motion: "drive arcs among textured things nearer than 2 m",
                ..metres("camera, forward of the axle", "camera.forward_m")
            },
            Self::CameraLeft => Nature {
                motion: "drive arcs among textured things nearer than 2 m",
                ..metres("camera, left of the middle", "camera.left_m")
            },
            Self::CameraHeight => Nature {
                motion: "drive straight over textured floor that the camera sees",
                ..metres("camera's height", "camera.height_m")
            },
            Self::CameraLatency => Nature {
                key: Some("devices.camera.latency_ms"),
                effect: "the pose of every frame while it rotates",
                ..milliseconds("camera's latency")
            },
            Self::FocalLength => Nature {
                motion: ROTATE,
                needed_sigma: 0.02,
                largest_change: 0.1,
                key: None,
                effect: "it changes every depth",
                ..scale("focal length's scale", "")
            },
        }
    }
}

fn scale(name: &'static str, key: &'static str) -> Nature {
    Nature {
        name,
        key: Some(key),
        unit: "",
        decimals: 4,
        needed_sigma: 0.01,
        largest_change: 0.15,
        motion: STRAIGHT,
        effect: "every distance by the wheels, and their drift to one side",
    }
}

fn metres(name: &'static str, key: &'static str) -> Nature {
    Nature {
        name,
        key: Some(key),
        unit: "m",
        decimals: 4,
        needed_sigma: 0.02,
        largest_change: 0.3,
        motion: STRAIGHT,
        effect: "where things are put into the map while it rotates",
    }
}

fn degrees(name: &'static str, key: &'static str) -> Nature {
    Nature {
        name,
        key: Some(key),
        unit: "deg",
        decimals: 2,
        needed_sigma: 0.5,
        largest_change: 15.0,
        motion: STRAIGHT,
        effect: "depth, and where it is put into the map",
    }
}

fn milliseconds(name: &'static str) -> Nature {
    Nature {
        name,
        key: None,
        unit: "ms",
        decimals: 1,
        needed_sigma: 10.0,
        largest_change: 250.0,
        motion: STOP_AND_GO,
        effect: "",
    }
}

/// A parameter with its old and its new value, in the unit of its nature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finding {
    pub parameter: Parameter,
    pub old: f64,
    pub new: f64,
    /// Standard deviation of `new`.
    pub sigma: f64,
}

/// What a finding is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The old value is within two standard deviations of the new one.
    AsConfigured,
    Changed,
    /// The drive did not show it.
    NotObserved,
    /// The new value cannot be right.
    Implausible,
}

impl Finding {
    /// Whether `calibration.toml` gets the new value, if the parameter has a key.
    #[must_use]
    pub fn is_written(&self) -> bool {
        matches!(self.verdict(), Verdict::AsConfigured | Verdict::Changed) && !self.is_early_scan()
    }

    /// Scans that are stamped early are not corrected, because a scan of the future would seem to be new for too long.
    fn is_early_scan(&self) -> bool {
        self.parameter == Parameter::LidarLatency && self.new < 0.0
    }

    /// What the finding is worth.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let nature = self.parameter.nature();
        let change = (self.new - self.old).abs();
        if self.sigma.is_nan() || self.sigma > nature.needed_sigma {
            Verdict::NotObserved
        } else if change.is_nan() || change > nature.largest_change {
            Verdict::Implausible
        } else if change <= 2.0 * self.sigma {
            Verdict::AsConfigured
        } else {
            Verdict::Changed
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Nature { name, unit, decimals, motion, effect, largest_change, needed_sigma, .. } =
            self.parameter.nature();
        let Self { old, new, sigma, .. } = self;
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        match self.verdict() {
            Verdict::NotObserved => write!(
                to,
                "{name}: this drive does not show it (+- {sigma:.decimals$}{unit}, but {needed_sigma}{unit} is needed). To measure it, {motion}"
            ),
            Verdict::Implausible => write!(
                to,
                "{name}: {old:.decimals$} -> {new:.decimals$} +- {sigma:.decimals$}{unit} is implausible: more than {largest_change}{unit} from the configuration"
            ),
            Verdict::AsConfigured => write!(
                to,
                "{name}: {old:.decimals$}{unit} as configured (measured {new:.decimals$} +- {sigma:.decimals$}{unit})"
            ),
            Verdict::Changed if self.is_early_scan() => write!(
                to,
                "{name}: {old:.decimals$}{unit} as configured (measured {new:.decimals$} +- {sigma:.decimals$}{unit}: scans are \
                 stamped early, or the wheels' reports late, which is not corrected)"
            ),
            Verdict::Changed => {
                write!(
                    to,
                    "{name}: {old:.decimals$} -> {new:.decimals$} +- {sigma:.decimals$}{unit}"
                )?;
                if effect.is_empty() { Ok(()) } else { write!(to, "; it changes {effect}") }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_that_are_stamped_early_are_reported_and_not_corrected() {
        let found = |parameter| Finding { parameter, old: 0.0, new: -5.4, sigma: 1.0 };
        let early = found(Parameter::LidarLatency);
        assert!(!early.is_written());
        let sentence = early.to_string();
        assert!(sentence.contains("0.0 ms as configured (measured -5.4 +- 1.0 ms"), "{sentence}");
        assert!(sentence.ends_with("which is not corrected)"), "{sentence}");
        // Frames may come from the future.
        let frames = found(Parameter::CameraLatency);
        assert!(frames.is_written() && frames.to_string().contains("0.0 -> -5.4"));
        let late = Finding { new: 5.4, ..early };
        assert!(late.is_written());
    }
}
