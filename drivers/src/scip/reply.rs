//! Requests for ranges, and the replies to them.

use hal::Range;

use super::line::{checked, decode};
use super::{RangeCodes, ScipError};

/// Characters of data in one line.
const LINE_CHARACTERS: usize = 64;

/// How many characters make a range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Two: up to 4095 mm (`MS`, `GS`).
    Two,
    /// Three: up to 262,143 mm (`MD`, `GD`).
    Three,
}

impl Encoding {
    fn characters(self) -> usize {
        match self {
            Self::Two => 2,
            Self::Three => 3,
        }
    }
}

/// Whether the sensor sends one scan or goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// The latest scan, once (`GD`, `GS`).
    Once,
    /// A new scan as often as asked for (`MD`, `MS`).
    Continuous {
        /// Scans left out between two that are sent, 0 to 9.
        skip: u8,
        /// Scans to send, 1 to 99; 0 for no end. The sensor counts it down in its echo.
        scans: u8,
    },
}

/// A request for ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// Characters for each range.
    pub encoding: Encoding,
    /// Once or continuously.
    pub mode: Mode,
    /// First step, 0 to 9999.
    pub first_step: u16,
    /// Last step, not before the first, up to 9999.
    pub last_step: u16,
    /// Neighbouring steps that are reduced to their nearest range, 1 to 99.
    pub cluster: u8,
}

impl Request {
    /// How many ranges the reply holds.
    #[must_use]
    pub fn beams(&self) -> usize {
        usize::from(self.last_step.saturating_sub(self.first_step)) / usize::from(self.cluster.max(1)) + 1
    }

    /// The bytes to send, and how many of the array they fill.
    #[must_use]
    pub fn encode(&self) -> ([u8; 16], usize) {
        let mut bytes = [b'\n'; 16];
        bytes[0] = if self.mode == Mode::Once { b'G' } else { b'M' };
        bytes[1] = if self.encoding == Encoding::Two { b'S' } else { b'D' };
        digits(&mut bytes[2..6], self.first_step);
        digits(&mut bytes[6..10], self.last_step);
        digits(&mut bytes[10..12], u16::from(self.cluster));
        let Mode::Continuous { skip, scans } = self.mode else { return (bytes, 13) };
        digits(&mut bytes[12..13], u16::from(skip));
        digits(&mut bytes[13..15], u16::from(scans));
        (bytes, 16)
    }

    /// The echo is the request, but for the scans that are left.
    fn is_echoed_by(&self, echo: &[u8]) -> bool {
        let (bytes, length) = self.encode();
        let sent = &bytes[..length - 1];
        let same = if self.mode == Mode::Once { sent.len() } else { sent.len() - 2 };
        echo.len() == sent.len() && echo[..same] == sent[..same] && echo[same..].iter().all(u8::is_ascii_digit)
    }
}

/// Decimal digits, the last ones where there are too many.
fn digits(place: &mut [u8], mut value: u16) {
    for digit in place.iter_mut().rev() {
        *digit = b'0' + (value % 10) as u8;
        value /= 10;
    }
}

/// What a sound reply says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reply {
    /// The request was accepted; scans will follow.
    Accepted,
    /// The ranges of one scan were written.
    Scan {
        /// The sensor's clock at step 0 of the scan; 24 bits, so it starts again every 4.66 hours.
        timestamp_ms: u32,
    },
}

/// Bytes of the first whole message in what has been received, with its empty line; `None` while it is not whole.
#[must_use]
pub fn message_length(received: &[u8]) -> Option<usize> {
    received.windows(2).position(|pair| pair == b"\n\n").map(|at| at + 2)
}

impl Reply {
    /// Reads one whole message into `ranges`, one for each beam of `request`, in the order of the sensor's steps
    /// (counter-clockwise from above).
    ///
    /// # Errors
    /// When anything about the reply is not as the protocol has it; `ranges` is then worthless.
    pub fn read(
        message: &[u8],
        request: &Request,
        codes: &RangeCodes,
        ranges: &mut [Range],
    ) -> Result<Self, ScipError> {
        if ranges.len() != request.beams() {
            return Err(ScipError::Buffer { buffer: ranges.len(), request: request.beams() });
        }
        let body = message.strip_suffix(b"\n\n").ok_or(ScipError::Shape { missing: "empty line at the end" })?;
        let mut lines = body.split(|byte| *byte == b'\n').enumerate();
        let mut next = |missing| lines.next().ok_or(ScipError::Shape { missing });
        if !request.is_echoed_by(next("echo")?.1) {
            return Err(ScipError::Echo);
        }
        let (number, status) = next("status")?;
        let continuous = request.mode != Mode::Once;
        match checked(status, number)? {
            b"00" if continuous => {
                return if lines.next().is_none() {
                    Ok(Self::Accepted)
                } else {
                    Err(ScipError::Shape { missing: "end" })
                };
            }
            b"99" if continuous => {}
            b"00" => {}
            &[a, b] => return Err(ScipError::Status { status: [a, b] }),
            _ => return Err(ScipError::Shape { missing: "status of two characters" }),
        }
        let (number, timestamp) = next("time stamp")?;
        let timestamp = checked(timestamp, number)?;
        if timestamp.len() != 4 {
            return Err(ScipError::Shape { missing: "time stamp of four characters" });
        }
        read_ranges(lines, request, codes, ranges)?;
        Ok(Self::Scan { timestamp_ms: decode(timestamp) })
    }
}

/// Ranges run on over the ends of lines: 64 is no multiple of three.
fn read_ranges<'a>(
    lines: impl Iterator<Item = (usize, &'a [u8])>,
    request: &Request,
    codes: &RangeCodes,
    ranges: &mut [Range],
) -> Result<(), ScipError> {
    let width = request.encoding.characters();
    let needed = ranges.len() * width;
    let (mut found, mut value) = (0, 0);
    for (number, line) in lines {
        let characters = checked(line, number)?;
        // Only the last line may be shorter.
        if found % LINE_CHARACTERS != 0 || characters.len() > LINE_CHARACTERS {
            return Err(ScipError::Shape { missing: "line of 64 characters" });
        }
        for character in characters {
            value = value << 6 | decode(std::slice::from_ref(character));
            found += 1;
            if found % width == 0 {
                if let Some(range) = ranges.get_mut(found / width - 1) {
                    *range = codes.range(value);
                }
                value = 0;
            }
        }
    }
    if found == needed { Ok(()) } else { Err(ScipError::Length { found, needed }) }
}

#[cfg(test)]
mod tests {
    use super::super::line::checksum;
    use super::*;
    use hal::{Error, ErrorKind};
    use proptest::prelude::*;

    const CODES: RangeCodes = RangeCodes::UTM_30LX;

    fn request(encoding: Encoding, mode: Mode, beams: u16) -> Request {
        Request { encoding, mode, first_step: 0, last_step: beams - 1, cluster: 1 }
    }

    const CONTINUOUS: Mode = Mode::Continuous { skip: 0, scans: 0 };

    fn push_line(message: &mut Vec<u8>, content: &[u8]) {
        message.extend_from_slice(content);
        message.push(checksum(content));
        message.push(b'\n');
    }

    fn characters(value: u32, count: usize) -> impl Iterator<Item = u8> {
        (0..count).rev().map(move |place| (value >> (6 * place) & 0x3f) as u8 + 0x30)
    }

    /// What a sensor sends.
    fn message(request: &Request, status: &[u8], timestamp_ms: u32, values: &[u32]) -> Vec<u8> {
        let (echo, length) = request.encode();
        let mut message = echo[..length].to_vec();
        push_line(&mut message, status);
        push_line(&mut message, &characters(timestamp_ms, 4).collect::<Vec<_>>());
        let width = request.encoding.characters();
        let data: Vec<u8> = values.iter().flat_map(|value| characters(*value, width)).collect();
        data.chunks(LINE_CHARACTERS).for_each(|line| push_line(&mut message, line));
        message.push(b'\n');
        message
    }

    fn read(message: &[u8], request: &Request) -> Result<(Reply, Vec<Range>), ScipError> {
        let mut ranges = vec![Range::NoReturn; request.beams()];
        Reply::read(message, request, &CODES, &mut ranges).map(|reply| (reply, ranges))
    }

    #[test]
    fn requests_are_the_commands_of_the_specification() {
        let text = |request: Request| {
            let (bytes, length) = request.encode();
            String::from_utf8(bytes[..length].to_vec()).unwrap()
        };
        let whole = Request { last_step: 1080, ..request(Encoding::Three, Mode::Continuous { skip: 2, scans: 15 }, 1) };
        assert_eq!(text(whole), "MD0000108001215\n");
        assert_eq!(text(Request { mode: Mode::Once, encoding: Encoding::Two, cluster: 12, ..whole }), "GS0000108012\n");
        assert_eq!((whole.beams(), Request { cluster: 12, ..whole }.beams()), (1081, 91));
    }

    #[test]
    fn a_message_is_whole_at_its_empty_line() {
        assert_eq!(message_length(b"MD\n00P\n"), None);
        assert_eq!(message_length(b"MD\n00P\n\nMD\n99b\n"), Some(8));
    }

    #[test]
    fn a_continuous_request_is_accepted_first() {
        let request = request(Encoding::Three, CONTINUOUS, 3);
        assert_eq!(read(b"MD0000000201000\n00P\n\n", &request).unwrap().0, Reply::Accepted);
    }

    #[test]
    fn the_count_of_scans_that_are_left_may_differ_from_the_request() {
        let request = request(Encoding::Three, Mode::Continuous { skip: 0, scans: 10 }, 2);
        let mut message = message(&request, b"99", 5, &[100, 200]);
        message[14] = b'7';
        assert!(read(&message, &request).is_ok());
        message[12] = b'7';
        assert_eq!(read(&message, &request), Err(ScipError::Echo));
    }

    #[test]
    fn refusals_and_faults_name_the_status_and_the_way_out() {
        let request = request(Encoding::Three, Mode::Once, 2);
        for (reply, word, kind) in [
            (&b"GD0000000101\n10Q\n\n"[..], "send BM", ErrorKind::Rejected),
            (b"GD0000000101\n04T\n\n", "last step", ErrorKind::Rejected),
            (b"GD0000000101\n70W\n\n", "hardware", ErrorKind::Fault),
        ] {
            let error = read(reply, &request).unwrap_err();
            assert!(error.to_string().contains(word) && error.kind() == kind, "{error}");
        }
    }

    #[test]
    fn a_scan_of_other_beams_than_asked_for_is_refused() {
        let asked = request(Encoding::Three, Mode::Once, 40);
        for beams in [0, 1, 39, 41, 200] {
            let message = message(&asked, b"00", 0, &vec![1000; beams]);
            assert!(matches!(read(&message, &asked), Err(ScipError::Length { .. })), "{beams}");
        }
        let error = Reply::read(&message(&asked, b"00", 0, &[1000; 40]), &asked, &CODES, &mut [Range::Error; 39]);
        assert_eq!(error, Err(ScipError::Buffer { buffer: 39, request: 40 }));
    }

    fn any_request() -> impl Strategy<Value = Request> {
        let encoding = prop_oneof![Just(Encoding::Two), Just(Encoding::Three)];
        let mode = prop_oneof![Just(Mode::Once), Just(CONTINUOUS)];
        (encoding, mode, 1..120_u16).prop_map(|(encoding, mode, beams)| request(encoding, mode, beams))
    }

    /// A request and a sound message for it, with its time stamp and values.
    fn exchange() -> impl Strategy<Value = (Request, Vec<u8>, u32, Vec<u32>)> {
        any_request().prop_flat_map(|request| {
            let limit = 1_u32 << (6 * request.encoding.characters());
            let values = proptest::collection::vec(0..limit, request.beams());
            let status: &[u8] = if request.mode == Mode::Once { b"00" } else { b"99" };
            (Just(request), 0..1_u32 << 24, values).prop_map(move |(request, time, values)| {
                (request, message(&request, status, time, &values), time, values)
            })
        })
    }

    proptest! {
        #[test]
        fn what_a_sensor_encodes_is_read_back((request, message, timestamp_ms, values) in exchange()) {
            let (reply, ranges) = read(&message, &request).unwrap();
            prop_assert_eq!(reply, Reply::Scan { timestamp_ms });
            let expected: Vec<_> = values.iter().map(|value| CODES.range(*value)).collect();
            prop_assert_eq!(ranges, expected);
        }

        #[test]
        fn any_changed_byte_is_noticed_or_changes_nothing(
            (request, message, ..) in exchange(), place in any::<prop::sample::Index>(), byte in any::<u8>(),
        ) {
            let sound = read(&message, &request).unwrap();
            let mut changed = message.clone();
            *place.get_mut(&mut changed) = byte;
            if let Ok(read) = read(&changed, &request) {
                prop_assert_eq!(read, sound);
            }
        }

        #[test]
        fn a_cut_message_is_refused((request, message, ..) in exchange(), at in any::<prop::sample::Index>()) {
            prop_assert!(read(&message[..at.index(message.len())], &request).is_err());
        }

        #[test]
        fn any_bytes_are_refused_without_a_panic(request in any_request(), bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(read(&bytes, &request).is_err());
        }
    }
}
