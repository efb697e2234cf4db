//! What the scanner says about itself.

use std::fmt;

/// The answer to [`Request::Info`](super::Request::Info).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Info {
    /// Number of the model; its upper half is the series.
    pub model: u8,
    /// Major and minor version of the firmware.
    pub firmware: (u8, u8),
    pub hardware: u8,
    pub serial: [u8; 16],
}

impl Info {
    /// Reads the data packet.
    #[must_use]
    pub fn read(bytes: &[u8; 20]) -> Self {
        let [model, minor, major, hardware, serial @ ..] = *bytes;
        Self { model, firmware: (major, minor), hardware, serial }
    }

    /// Writes the data packet as the scanner sends it.
    #[must_use]
    pub fn write(&self) -> [u8; 20] {
        let mut bytes = [0; 20];
        bytes[..4].copy_from_slice(&[self.model, self.firmware.1, self.firmware.0, self.hardware]);
        bytes[4..].copy_from_slice(&self.serial);
        bytes
    }

    /// The number of the series: 1 for A1, 2 for A2, 3 for A3, 7 for S2.
    #[must_use]
    pub fn series(&self) -> u8 {
        self.model >> 4
    }

    /// The serial number as the maker's software prints it.
    #[must_use]
    pub fn serial_text(&self) -> String {
        self.serial.iter().map(|byte| format!("{byte:02X}")).collect()
    }
}

/// The scanner's state of health.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HealthState {
    Good,
    /// Works, but may not for long.
    Warning,
    /// Is in its protection stop and does not scan.
    Error,
    /// A number that the protocol does not know.
    Unknown(u8),
}

/// The answer to [`Request::Health`](super::Request::Health).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health {
    pub state: HealthState,
    /// The scanner's number of the problem.
    pub code: u16,
}

impl Health {
    /// Reads the data packet.
    #[must_use]
    pub fn read(bytes: &[u8; 3]) -> Self {
        let state = match bytes[0] {
            0 => HealthState::Good,
            1 => HealthState::Warning,
            2 => HealthState::Error,
            other => HealthState::Unknown(other),
        };
        Self { state, code: u16::from_le_bytes([bytes[1], bytes[2]]) }
    }

    /// Writes the data packet as the scanner sends it.
    #[must_use]
    pub fn write(&self) -> [u8; 3] {
        let state = match self.state {
            HealthState::Good => 0,
            HealthState::Warning => 1,
            HealthState::Error => 2,
            HealthState::Unknown(other) => other,
        };
        let [low, high] = self.code.to_le_bytes();
        [state, low, high]
    }

    /// Whether the scanner can scan.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        matches!(self.state, HealthState::Good | HealthState::Warning)
    }
}

impl fmt::Display for Health {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.state {
            HealthState::Good => "good",
            HealthState::Warning => "warning",
            HealthState::Error => "error",
            HealthState::Unknown(_) => "unknown",
        };
        write!(f, "{word}, code {:#06x}", self.code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_protection_stop_is_not_usable_and_has_its_code() {
        let health = Health::read(&[2, 0x02, 0x80]);
        assert!(!health.is_usable());
        assert_eq!(health.to_string(), "error, code 0x8002");
        assert!(Health::read(&[0, 0, 0]).is_usable() && Health::read(&[1, 0, 0]).is_usable());
        assert!(!Health::read(&[9, 0, 0]).is_usable());
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_again(info: [u8; 20], health: [u8; 3]) {
            prop_assert_eq!(Info::read(&info).write(), info);
            prop_assert_eq!(Health::read(&health).write(), health);
        }
    }
}
