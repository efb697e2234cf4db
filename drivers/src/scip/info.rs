//! What a sensor says about itself.

use super::{Answer, ScipError};

/// Who it is (`VV`). A line that fails its checksum is left out: the URG-04LX computes that of its serial number wrongly
/// (<https://github.com/ros-drivers/urg_c/pull/4>), and nothing is decided by these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Version<'a> {
    /// Maker.
    pub vendor: Option<&'a str>,
    /// Product.
    pub product: Option<&'a str>,
    /// Firmware's version.
    pub firmware: Option<&'a str>,
    /// Protocol's version.
    pub protocol: Option<&'a str>,
    /// Serial number.
    pub serial: Option<&'a str>,
}

impl<'a> Version<'a> {
    /// Reads the answer to [`Command::Version`](super::Command::Version).
    #[must_use]
    pub fn read(answer: &Answer<'a>) -> Self {
        let field = |key| answer.field(key).ok();
        Self {
            vendor: field("VEND"),
            product: field("PROD"),
            firmware: field("FIRM"),
            protocol: field("PROT"),
            serial: field("SERI"),
        }
    }
}

/// How it measures (`PP`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parameters<'a> {
    /// Model, with the maker's name in brackets.
    pub model: &'a str,
    /// Shortest distance, millimetres.
    pub dmin_mm: u32,
    /// Longest distance, millimetres.
    pub dmax_mm: u32,
    /// Steps in a full turn.
    pub steps_per_turn: u32,
    /// First step that is measured.
    pub first_step: u32,
    /// Last step that is measured.
    pub last_step: u32,
    /// The step that looks ahead.
    pub front_step: u32,
    /// Turns in a minute.
    pub rpm: u32,
}

impl<'a> Parameters<'a> {
    /// Reads the answer to [`Command::Parameters`](super::Command::Parameters).
    ///
    /// # Errors
    /// When a line is missing, fails its checksum or holds no number: ranges cannot be understood without it.
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

/// How it is (`II`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct State<'a> {
    /// `ON` or `OFF`.
    pub laser: Option<&'a str>,
    /// Whether and how it measures.
    pub measurement: Option<&'a str>,
    /// In its own words, for people: "Sensor works well.", "Stable 000 no error.", a fault.
    pub status: Option<&'a str>,
}

impl<'a> State<'a> {
    /// Reads the answer to [`Command::State`](super::Command::State).
    #[must_use]
    pub fn read(answer: &Answer<'a>) -> Self {
        let field = |key| answer.field(key).ok();
        Self { laser: field("LASR"), measurement: field("MESM"), status: field("STAT") }
    }

    /// Whether it says that its laser is off.
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
    fn a_wrong_checksum_of_the_serial_number_costs_only_the_serial_number() {
        let answer = Answer::read(b"VV\n00P\nPROD:X;7\nSERI:H0;?\n\n", Command::Version).unwrap();
        let version = Version::read(&answer);
        assert_eq!((version.product, version.serial), (Some("X"), None));
    }
}
