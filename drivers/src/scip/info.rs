//! The information that a sensor reports about itself.

use super::{Answer, ScipError};

/// The sensor's identification (`VV`). A line with a wrong checksum is omitted: the URG-04LX
/// computes the checksum of its serial number incorrectly
/// (<https://github.com/ros-drivers/urg_c/pull/4>), and no decision depends on these values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Version<'a> {
    pub vendor: Option<&'a str>,
    pub product: Option<&'a str>,
    pub firmware: Option<&'a str>,
    pub protocol: Option<&'a str>,
    pub serial: Option<&'a str>,
}

impl<'a> Version<'a> {
    /// Parses the answer to [`Command::Version`](super::Command::Version).
    #[must_use]
    pub fn read(answer: &Answer<'a>) -> Self {
        Self {
            vendor: answer.field("VEND").ok(),
            product: answer.field("PROD").ok(),
            firmware: answer.field("FIRM").ok(),
            protocol: answer.field("PROT").ok(),
            serial: answer.field("SERI").ok(),
        }
    }
}

/// The sensor's measurement parameters (`PP`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parameters<'a> {
    /// The model, with the manufacturer's name in brackets.
    pub model: &'a str,
    pub dmin_mm: u32,
    pub dmax_mm: u32,
    /// Number of steps of a full revolution.
    pub steps_per_turn: u32,
    pub first_step: u32,
    pub last_step: u32,
    /// The step that points straight ahead.
    pub front_step: u32,
    /// Speed of the mirror, revolutions per minute.
    pub rpm: u32,
}

impl<'a> Parameters<'a> {
    /// Parses the answer to [`Command::Parameters`](super::Command::Parameters).
    ///
    /// # Errors
    /// When a line is missing, has a wrong checksum or is not a number. Ranges cannot be
    /// interpreted without it.
    pub fn read(answer: &Answer<'a>) -> Result<Self, ScipError> {
        Ok(Self {
            model: answer.field("MODL")?,
            dmin_mm: answer.number("DMIN")?,
            dmax_mm: answer.number("DMAX")?,
            steps_per_turn: answer.number("ARES")?,
            first_step: answer.number("AMIN")?,
            last_step: answer.number("AMAX")?,
            front_step: answer.number("AFRT")?,
            rpm: answer.number("SCAN")?,
        })
    }
}

/// The sensor's state (`II`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct State<'a> {
    /// State of the laser: `ON` or `OFF`.
    pub laser: Option<&'a str>,
    /// Whether and how the sensor measures.
    pub measurement: Option<&'a str>,
    /// The sensor's own text, such as "Sensor works well.", "Stable 000 no error." or a fault.
    pub status: Option<&'a str>,
}

impl<'a> State<'a> {
    /// Parses the answer to [`Command::State`](super::Command::State).
    #[must_use]
    pub fn read(answer: &Answer<'a>) -> Self {
        Self {
            laser: answer.field("LASR").ok(),
            measurement: answer.field("MESM").ok(),
            status: answer.field("STAT").ok(),
        }
    }

    /// Whether the sensor reports that its laser is off.
    #[must_use]
    pub fn laser_is_off(&self) -> bool {
        self.laser.is_some_and(|laser| laser.starts_with("OFF"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Command;
    use super::*;

    #[test]
    fn the_parameters_of_the_specification_are_read() {
        let message =
            b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co., Ltd.);n\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\nAMIN:44;7\n\
            AMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n";
        let answer = Answer::read(message, Command::Parameters).unwrap();
        let parameters = Parameters::read(&answer).unwrap();
        assert_eq!(
            (parameters.dmin_mm, parameters.dmax_mm, parameters.steps_per_turn),
            (20, 5600, 1024)
        );
        assert_eq!(
            (parameters.first_step, parameters.last_step, parameters.front_step),
            (44, 725, 384)
        );
        assert_eq!(
            (parameters.model, parameters.rpm),
            ("URG-04LX(Hokuyo Automatic Co., Ltd.)", 600)
        );
    }

    #[test]
    fn a_wrong_checksum_of_the_serial_number_omits_only_the_serial_number() {
        let answer = Answer::read(b"VV\n00P\nPROD:X;7\nSERI:H0;?\n\n", Command::Version).unwrap();
        let version = Version::read(&answer);
        assert_eq!((version.product, version.serial), (Some("X"), None));
    }
}
