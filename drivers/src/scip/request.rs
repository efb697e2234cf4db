//! Encoding of requests for ranges.

/// The number of characters per range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Two characters: ranges up to 4095 mm (`MS`, `GS`).
    Two,
    /// Three characters: ranges up to 262,143 mm (`MD`, `GD`).
    Three,
    /// Three characters, and three more for the intensity of the echo, which has no unit (`ME`,
    /// `GE`). The URG-04LX does not support it and may hang on the request.
    ThreeWithIntensity,
}

impl Encoding {
    /// The number of characters per beam.
    #[must_use]
    pub fn characters(self) -> usize {
        match self {
            Self::Two => 2,
            Self::Three => 3,
            Self::ThreeWithIntensity => 6,
        }
    }

    fn letter(self) -> u8 {
        match self {
            Self::Two => b'S',
            Self::Three => b'D',
            Self::ThreeWithIntensity => b'E',
        }
    }
}

/// Whether the sensor sends one scan or a sequence of scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// The latest scan (`GD`, `GS`, `GE`).
    Once,
    /// New scans (`MD`, `MS`, `ME`).
    Continuous {
        /// Number of scans omitted between two that are sent, 0 to 9.
        skip: u8,
        /// Number of scans to send, 1 to 99, or 0 for no end. The sensor counts it down in its
        /// echo.
        scans: u8,
    },
}

/// A request for ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    pub encoding: Encoding,
    pub mode: Mode,
    /// First step, 0 to 9999.
    pub first_step: u16,
    /// Last step, from `first_step` to 9999.
    pub last_step: u16,
    /// Number of neighbouring steps that are merged to their nearest range, 1 to 99.
    pub cluster: u8,
}

/// Number of the last digits of a continuous request that count down in its echoes.
const COUNT_DIGITS: usize = 2;

impl Request {
    /// The number of ranges in the reply.
    #[must_use]
    pub fn beams(&self) -> usize {
        usize::from(self.last_step.saturating_sub(self.first_step))
            / usize::from(self.cluster.max(1))
            + 1
    }

    /// The bytes to send, and their number.
    #[must_use]
    pub fn encode(&self) -> ([u8; 16], usize) {
        let mut bytes = [b'\n'; 16];
        bytes[0] = if self.mode == Mode::Once { b'G' } else { b'M' };
        bytes[1] = self.encoding.letter();
        write_digits(&mut bytes[2..6], self.first_step);
        write_digits(&mut bytes[6..10], self.last_step);
        write_digits(&mut bytes[10..12], u16::from(self.cluster));
        let Mode::Continuous { skip, scans } = self.mode else { return (bytes, 13) };
        write_digits(&mut bytes[12..13], u16::from(skip));
        write_digits(&mut bytes[13..15], u16::from(scans));
        (bytes, 16)
    }

    /// The bytes of the request, the length of the part that the echo repeats exactly, and the
    /// number of digits after it.
    fn echo(&self) -> ([u8; 16], usize, usize) {
        let (bytes, length) = self.encode();
        let counted = if self.mode == Mode::Once { 0 } else { COUNT_DIGITS };
        (bytes, length - 1 - counted, counted)
    }

    /// Whether a line is the echo of this request. Only the number of remaining scans may differ.
    pub(super) fn is_echoed_by(&self, line: &[u8]) -> bool {
        let (bytes, same, counted) = self.echo();
        let Some((start, count)) = line.split_at_checked(same) else { return false };
        start == &bytes[..same] && count.len() == counted && count.iter().all(u8::is_ascii_digit)
    }

    /// Skips noise or a truncated reply at the start of a message: returns the part from the last
    /// echo of this request. The caller must still parse that part, which checks it.
    #[must_use]
    pub fn last_echo<'a>(&self, message: &'a [u8]) -> Option<&'a [u8]> {
        let (bytes, same, _) = self.echo();
        let at = message.windows(same).rposition(|window| window == &bytes[..same])?;
        message.get(at..)
    }
}

/// Writes decimal digits. Leading digits that do not fit are dropped.
fn write_digits(place: &mut [u8], mut value: u16) {
    for digit in place.iter_mut().rev() {
        *digit = b'0' + (value % 10) as u8;
        value /= 10;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: Request = Request {
        encoding: Encoding::Three,
        mode: Mode::Continuous { skip: 2, scans: 15 },
        first_step: 0,
        last_step: 1080,
        cluster: 1,
    };

    fn text(request: Request) -> String {
        let (bytes, length) = request.encode();
        String::from_utf8(bytes[..length].to_vec()).unwrap()
    }

    #[test]
    fn requests_have_the_bytes_of_the_specification() {
        assert_eq!(text(WHOLE), "MD0000108001215\n");
        assert_eq!(
            text(Request { mode: Mode::Once, encoding: Encoding::Two, cluster: 12, ..WHOLE }),
            "GS0000108012\n"
        );
        assert_eq!(
            text(Request { encoding: Encoding::ThreeWithIntensity, ..WHOLE }),
            "ME0000108001215\n"
        );
        assert_eq!((WHOLE.beams(), Request { cluster: 12, ..WHOLE }.beams()), (1081, 91));
    }

    #[test]
    fn a_message_starts_at_its_last_echo() {
        let found = WHOLE.last_echo(b"noise MD0000108001214 more MD0000108001213\n99b\n\n");
        assert_eq!(found, Some(&b"MD0000108001213\n99b\n\n"[..]));
        assert_eq!(WHOLE.last_echo(b"GD000"), None);
    }
}
