//! The commands that request no ranges, and their answers.

use super::ScipError;
use super::line::{checked, checksum, decode};
use super::reply::split_line;

/// A command that requests no ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// `SCIP2.0`: leave SCIP 1.1. Only for sensors that start in it, because others may hang on an
    /// unknown command.
    Scip2,
    /// `QT`: stop measuring, laser off.
    Quit,
    /// `RS`: reset laser, motor speed, bit rate and clock to their state after power-on.
    Reset,
    /// `BM`: switch the laser on.
    LaserOn,
    /// `VV`: request the [`Version`](super::Version).
    Version,
    /// `PP`: request the [`Parameters`](super::Parameters).
    Parameters,
    /// `II`: request the [`State`](super::State).
    State,
    /// `TM0`: start the time adjustment mode. The laser is off until `TM2`.
    TimeStart,
    /// `TM1`: request the time of the sensor's clock.
    Time,
    /// `TM2`: end the time adjustment mode.
    TimeEnd,
}

impl Command {
    /// The bytes to send, including the LF.
    #[must_use]
    pub fn bytes(self) -> &'static [u8] {
        match self {
            Self::Scip2 => b"SCIP2.0\n",
            Self::Quit => b"QT\n",
            Self::Reset => b"RS\n",
            Self::LaserOn => b"BM\n",
            Self::Version => b"VV\n",
            Self::Parameters => b"PP\n",
            Self::State => b"II\n",
            Self::TimeStart => b"TM0\n",
            Self::Time => b"TM1\n",
            Self::TimeEnd => b"TM2\n",
        }
    }
}

/// A well-formed answer with its status. Which statuses mean success depends on the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer<'a> {
    /// Two characters. `00` means success for every command.
    pub status: [u8; 2],
    /// The lines after the status, with their checksums.
    lines: &'a [u8],
}

impl<'a> Answer<'a> {
    /// Parses one whole message. Bytes before the echo are skipped: noise on the line, or the end
    /// of a scan.
    ///
    /// # Errors
    /// [`ScipError::Echo`] when the message answers another command, [`ScipError::OldProtocol`]
    /// when the sensor speaks SCIP 1.1, or another error when a checksum or the form is wrong.
    pub fn read(message: &'a [u8], command: Command) -> Result<Self, ScipError> {
        let body = message
            .strip_suffix(b"\n\n")
            .ok_or(ScipError::Shape { missing: "empty line at the end" })?;
        let echo = command.bytes();
        let at =
            body.windows(echo.len()).rposition(|window| window == echo).ok_or(ScipError::Echo)?;
        let (status, lines) = split_line(body.get(at + echo.len()..).unwrap_or_default());
        match status {
            // SCIP 1.1 has no checksums: `0` means success, `E` an unknown command.
            b"0" if command == Command::Scip2 => return Ok(Self { status: *b"00", lines: &[] }),
            [b'0'..=b'9' | b'A'..=b'Z'] => return Err(ScipError::OldProtocol),
            _ => {}
        }
        match checked(status, 1)? {
            &[a, b] => Ok(Self { status: [a, b], lines: lines.unwrap_or_default() }),
            _ => Err(ScipError::Shape { missing: "status of two characters" }),
        }
    }

    /// Returns the answer itself if its status is `00`.
    ///
    /// # Errors
    /// [`ScipError::Status`] for any other status.
    pub fn done(self) -> Result<Self, ScipError> {
        if self.status == *b"00" {
            Ok(self)
        } else {
            Err(ScipError::Status { status: self.status })
        }
    }

    /// The time of the sensor's clock in milliseconds, 24 bits.
    ///
    /// # Errors
    /// When this is not the answer to [`Command::Time`], or its checksum is wrong.
    pub fn time_ms(&self) -> Result<u32, ScipError> {
        let time = checked(self.lines, 2)?;
        if time.len() == 4 {
            Ok(decode(time))
        } else {
            Err(ScipError::Shape { missing: "time of four characters" })
        }
    }

    /// The value of the line `KEY:value;checksum`, without surrounding spaces.
    ///
    /// # Errors
    /// [`ScipError::Field`] when there is no such line, its checksum is wrong, or it is not
    /// printable ASCII.
    pub fn field(&self, key: &'static str) -> Result<&'a str, ScipError> {
        let wrong = ScipError::Field { key };
        let line = self
            .lines
            .split(|byte| *byte == b'\n')
            .find(|line| line.starts_with(key.as_bytes()))
            .ok_or(wrong)?;
        let Some((content, &[b';', sum])) = line.split_last_chunk::<2>() else { return Err(wrong) };
        let text = core::str::from_utf8(content)
            .ok()
            .filter(|text| text.bytes().all(|byte| matches!(byte, b' '..=b'~')));
        let value = text.and_then(|text| text.strip_prefix(key)?.strip_prefix(':')).ok_or(wrong)?;
        if checksum(content) == sum { Ok(value.trim()) } else { Err(wrong) }
    }

    /// The numeric value of a line.
    ///
    /// # Errors
    /// As [`field`](Self::field), and when the value is not a number.
    pub fn number(&self, key: &'static str) -> Result<u32, ScipError> {
        self.field(key)?.parse().map_err(|_| ScipError::Field { key })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn noise_before_the_echo_is_skipped() {
        let answer = Answer::read(b"\xff\x00o3QT\n00P\n\n", Command::Quit);
        assert_eq!(answer.map(|answer| answer.status), Ok(*b"00"));
        assert_eq!(Answer::read(b"BM\n00P\n\n", Command::Quit), Err(ScipError::Echo));
    }

    #[test]
    fn a_status_with_a_wrong_checksum_is_refused() {
        assert!(matches!(
            Answer::read(b"QT\n00Q\n\n", Command::Quit),
            Err(ScipError::Checksum { .. })
        ));
    }

    #[test]
    fn a_sensor_in_scip_1_is_detected_and_can_be_switched_to_scip_2() {
        assert_eq!(Answer::read(b"QT\nE\n\n", Command::Quit), Err(ScipError::OldProtocol));
        assert!(Answer::read(b"SCIP2.0\n0\n\n", Command::Scip2).unwrap().done().is_ok());
    }

    #[test]
    fn the_time_has_four_characters_and_a_checksum() {
        assert_eq!(time_ms(b"TM1\n00P\nm2@0?\n\n"), Ok(16_000_000));
        assert!(matches!(time_ms(b"TM1\n00P\nm2@1?\n\n"), Err(ScipError::Checksum { .. })));
        assert!(matches!(time_ms(b"TM1\n00P\n\n"), Err(ScipError::Shape { .. })));
    }

    fn time_ms(message: &[u8]) -> Result<u32, ScipError> {
        Answer::read(message, Command::Time)?.time_ms()
    }

    #[test]
    fn each_field_is_checked_separately() {
        // The example of the specification without its spaces, which its checksums do not include.
        let answer =
            Answer::read(b"PP\n00P\nDMIN:20;4\nDMAX:5600;x\n\n", Command::Parameters).unwrap();
        assert_eq!(answer.number("DMIN"), Ok(20));
        assert_eq!(
            answer.number("DMAX"),
            Err(ScipError::Field { key: "DMAX" }),
            "the checksum is wrong"
        );
        assert_eq!(
            answer.number("ARES"),
            Err(ScipError::Field { key: "ARES" }),
            "the line is missing"
        );
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed_without_a_panic(
            bytes in proptest::collection::vec(any::<u8>(), 0..60),
        ) {
            for command in [Command::Quit, Command::Scip2, Command::Parameters, Command::Time] {
                let mut message = command.bytes().to_vec();
                message.extend(&bytes);
                message.extend(b"\n\n");
                if let Ok(answer) = Answer::read(&message, command) {
                    _ = (answer.time_ms(), answer.field("MODL"), answer.number("DMIN"));
                }
            }
        }
    }
}
