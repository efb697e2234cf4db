//! Parsing of the replies to requests for ranges.

use hal::Range;

use super::data::{self, Beams};
use super::line::{checked, decode};
use super::{Encoding, Mode, RangeCodes, Request, ScipError};

/// The content of a valid reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reply {
    /// The request was accepted; scans follow.
    Accepted,
    /// The reply contained a scan, whose ranges were written into the buffer.
    Scan {
        /// Time of the sensor's clock at step 0 of the scan. It has 24 bits and wraps every 4.66
        /// hours.
        timestamp_ms: u32,
    },
}

impl Reply {
    /// Parses one complete message and writes one range for each beam of `request` into `ranges`,
    /// in the order of the sensor's steps (counter-clockwise from above).
    ///
    /// # Errors
    /// When the reply violates the protocol in any way. The contents of `ranges` are invalid then.
    pub fn read(
        message: &[u8],
        request: &Request,
        codes: &RangeCodes,
        ranges: &mut [Range],
    ) -> Result<Self, ScipError> {
        Self::read_with_intensities(message, request, codes, ranges, &mut [])
    }

    /// As [`read`](Self::read), and also writes the intensities of the echoes: one per beam for
    /// [`Encoding::ThreeWithIntensity`], otherwise `intensities` must be empty.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_with_intensities(
        message: &[u8],
        request: &Request,
        codes: &RangeCodes,
        ranges: &mut [Range],
        intensities: &mut [u32],
    ) -> Result<Self, ScipError> {
        let beams = request.beams();
        let intensity_count =
            if request.encoding == Encoding::ThreeWithIntensity { beams } else { 0 };
        for (buffer, request) in [(ranges.len(), beams), (intensities.len(), intensity_count)] {
            if buffer != request {
                return Err(ScipError::Buffer { buffer, request });
            }
        }
        let body = message
            .strip_suffix(b"\n\n")
            .ok_or(ScipError::Shape { missing: "empty line at the end" })?;
        let (echo, body) = split_line(body);
        if !request.is_echoed_by(echo) {
            return Err(ScipError::Echo);
        }
        let (status, body) = split_line(body.ok_or(ScipError::Shape { missing: "status" })?);
        let continuous = request.mode != Mode::Once;
        match checked(status, 1)? {
            b"00" if continuous && body.is_none() => return Ok(Self::Accepted),
            b"00" if continuous => return Err(ScipError::Shape { missing: "end" }),
            b"99" if continuous => {}
            b"00" => {}
            &[a, b] => return Err(ScipError::Status { status: [a, b] }),
            _ => return Err(ScipError::Shape { missing: "status of two characters" }),
        }
        let (timestamp, body) = split_line(body.ok_or(ScipError::Shape { missing: "timestamp" })?);
        let timestamp = checked(timestamp, 2)?;
        if timestamp.len() != 4 {
            return Err(ScipError::Shape { missing: "timestamp of four characters" });
        }
        // The LF before the empty line belongs to the last data line.
        let start = message.len() - 1 - body.map_or(0, |body| body.len() + 1);
        let lines = message.get(start..message.len() - 1).unwrap_or_default();
        let mut beams = Beams { codes, ranges, intensities };
        match request.encoding {
            Encoding::Two => data::read::<2>(lines, 3, &mut beams),
            Encoding::Three | Encoding::ThreeWithIntensity => data::read::<3>(lines, 3, &mut beams),
        }?;
        Ok(Self::Scan { timestamp_ms: decode(timestamp) })
    }
}

/// The first line, and the bytes after its LF if there is one.
pub(super) fn split_line(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    match bytes.iter().position(|byte| *byte == b'\n') {
        Some(at) => (&bytes[..at], bytes.get(at + 1..)),
        None => (bytes, None),
    }
}

#[cfg(test)]
mod tests {
    use super::super::data::LINE;
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

    /// Encodes a reply as a sensor does.
    fn message(request: &Request, status: &[u8], timestamp_ms: u32, values: &[u32]) -> Vec<u8> {
        let (echo, length) = request.encode();
        let mut message = echo[..length].to_vec();
        push_line(&mut message, status);
        push_line(&mut message, &characters(timestamp_ms, 4).collect::<Vec<_>>());
        let width = if request.encoding == Encoding::Two { 2 } else { 3 };
        let data: Vec<u8> = values.iter().flat_map(|value| characters(*value, width)).collect();
        data.chunks(LINE).for_each(|line| push_line(&mut message, line));
        message.push(b'\n');
        message
    }

    fn intensity_count(request: &Request) -> usize {
        if request.encoding == Encoding::ThreeWithIntensity { request.beams() } else { 0 }
    }

    fn read(message: &[u8], request: &Request) -> Result<(Reply, Vec<Range>, Vec<u32>), ScipError> {
        let mut ranges = vec![Range::NoReturn; request.beams()];
        let mut intensities = vec![0; intensity_count(request)];
        let reply =
            Reply::read_with_intensities(message, request, &CODES, &mut ranges, &mut intensities)?;
        Ok((reply, ranges, intensities))
    }

    #[test]
    fn the_first_reply_to_a_continuous_request_accepts_it() {
        let request = request(Encoding::Three, CONTINUOUS, 3);
        assert_eq!(read(b"MD0000000201000\n00P\n\n", &request).unwrap().0, Reply::Accepted);
    }

    #[test]
    fn the_number_of_remaining_scans_may_differ_from_the_request() {
        let request = request(Encoding::Three, Mode::Continuous { skip: 0, scans: 10 }, 2);
        let mut message = message(&request, b"99", 5, &[100, 200]);
        message[14] = b'7';
        assert!(read(&message, &request).is_ok());
        message[12] = b'7';
        assert_eq!(read(&message, &request), Err(ScipError::Echo));
    }

    #[test]
    fn refusals_and_faults_have_the_right_kind_and_name_the_remedy() {
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
    fn a_scan_with_another_number_of_beams_than_requested_is_refused() {
        let requested = request(Encoding::Three, Mode::Once, 40);
        for beams in [0, 1, 39, 41, 200] {
            let message = message(&requested, b"00", 0, &vec![1000; beams]);
            assert!(matches!(read(&message, &requested), Err(ScipError::Length { .. })), "{beams}");
        }
        let error = Reply::read(
            &message(&requested, b"00", 0, &[1000; 40]),
            &requested,
            &CODES,
            &mut [Range::Error; 39],
        );
        assert_eq!(error, Err(ScipError::Buffer { buffer: 39, request: 40 }));
    }

    fn any_request() -> impl Strategy<Value = Request> {
        let encoding = prop_oneof![
            Just(Encoding::Two),
            Just(Encoding::Three),
            Just(Encoding::ThreeWithIntensity)
        ];
        let mode = prop_oneof![Just(Mode::Once), Just(CONTINUOUS)];
        (encoding, mode, 1..120_u16)
            .prop_map(|(encoding, mode, beams)| request(encoding, mode, beams))
    }

    /// A request and a valid reply to it, with its timestamp and values.
    fn exchange() -> impl Strategy<Value = (Request, Vec<u8>, u32, Vec<u32>)> {
        any_request().prop_flat_map(|request| {
            let limit: u32 = if request.encoding == Encoding::Two { 1 << 12 } else { 1 << 18 };
            let value = prop_oneof![0..30_u32, 0..limit, 0..limit.min(70_000)];
            let values =
                proptest::collection::vec(value, request.beams() + intensity_count(&request));
            let status: &[u8] = if request.mode == Mode::Once { b"00" } else { b"99" };
            (Just(request), 0..1_u32 << 24, values).prop_map(move |(request, time, values)| {
                (request, message(&request, status, time, &values), time, values)
            })
        })
    }

    proptest! {
        #[test]
        fn a_reply_is_decoded_as_it_was_encoded(
            (request, message, timestamp_ms, values) in exchange(),
        ) {
            let (reply, ranges, intensities) = read(&message, &request).unwrap();
            prop_assert_eq!(reply, Reply::Scan { timestamp_ms });
            let step = if request.encoding == Encoding::ThreeWithIntensity { 2 } else { 1 };
            let expected: Vec<_> =
                values.iter().step_by(step).map(|value| CODES.range(*value)).collect();
            prop_assert_eq!(ranges, expected);
            let expected: Vec<_> =
                values.iter().skip(1).step_by(2).copied().take(intensities.len()).collect();
            prop_assert_eq!(intensities, expected);
        }

        #[test]
        fn a_changed_byte_is_refused_or_does_not_change_the_scan(
            (request, message, ..) in exchange(),
            place in any::<prop::sample::Index>(),
            byte in any::<u8>(),
        ) {
            let sound = read(&message, &request).unwrap();
            let mut changed = message.clone();
            *place.get_mut(&mut changed) = byte;
            if let Ok(read) = read(&changed, &request) {
                prop_assert_eq!(read, sound);
            }
        }

        #[test]
        fn a_truncated_message_is_refused(
            (request, message, ..) in exchange(),
            at in any::<prop::sample::Index>(),
        ) {
            prop_assert!(read(&message[..at.index(message.len())], &request).is_err());
        }

        #[test]
        fn random_bytes_are_refused(
            request in any_request(),
            bytes in proptest::collection::vec(any::<u8>(), 0..200),
        ) {
            prop_assert!(read(&bytes, &request).is_err());
        }
    }
}
