//! What the host sends: `A5`, a command and, with commands from 80 on, a payload with its length and a
//! checksum.

/// Longest request, bytes.
pub const REQUEST_BYTES: usize = 9;

const START: u8 = 0xa5;
/// Commands with this bit have a payload.
const HAS_PAYLOAD: u8 = 0x80;

/// A command of the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// End the scan. Not answered.
    Stop,
    /// Restart the scanner. Not answered.
    Reset,
    /// Scan, one answer for each measurement.
    Scan,
    /// Scan, several measurements in each answer.
    ExpressScan {
        /// The scanner's number for the kind of scan; 0 is the one of all models (legacy capsules).
        working_mode: u8,
    },
    /// Model, firmware and serial number.
    Info,
    /// State of health.
    Health,
    /// Duty cycle of the motor, 0 to 1023; 0 stops it (A2 and A3). Not answered.
    MotorPwm(u16),
    /// Rotation in revolutions per minute; 0 stops the motor (S series). Not answered.
    MotorSpeed(u16),
}

impl Request {
    fn command(self) -> u8 {
        match self {
            Self::Stop => 0x25,
            Self::Reset => 0x40,
            Self::Scan => 0x20,
            Self::ExpressScan { .. } => 0x82,
            Self::Info => 0x50,
            Self::Health => 0x52,
            Self::MotorPwm(_) => 0xf0,
            Self::MotorSpeed(_) => 0xa8,
        }
    }

    /// The bytes of the request, and how many of them there are.
    #[must_use]
    pub fn encode(self) -> ([u8; REQUEST_BYTES], usize) {
        let mut bytes = [0; REQUEST_BYTES];
        bytes[0] = START;
        bytes[1] = self.command();
        let payload = match self {
            Self::ExpressScan { working_mode } => {
                bytes[3] = working_mode;
                5
            }
            Self::MotorPwm(value) | Self::MotorSpeed(value) => {
                bytes[3..5].copy_from_slice(&value.to_le_bytes());
                2
            }
            _ => return (bytes, 2),
        };
        bytes[2] = payload;
        let end = 3 + usize::from(payload);
        bytes[end] = bytes[..end].iter().fold(0, |sum, byte| sum ^ byte);
        (bytes, end + 1)
    }

    /// Reads the first request in these bytes. Also returns how many bytes it has, or how many bytes
    /// are no request. `None` while it is incomplete.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<(Option<Self>, usize)> {
        if *bytes.first()? != START {
            return Some((None, 1));
        }
        let command = *bytes.get(1)?;
        if command & HAS_PAYLOAD == 0 {
            return Some((Self::without_payload(command), 2));
        }
        let end = 3 + usize::from(*bytes.get(2)?);
        let sum = *bytes.get(end)?;
        let is_sound = bytes.get(..end)?.iter().fold(0, |sum, byte| sum ^ byte) == sum;
        let request = is_sound.then(|| Self::with_payload(command, &bytes[3..end])).flatten();
        Some((request, if is_sound { end + 1 } else { 1 }))
    }

    fn without_payload(command: u8) -> Option<Self> {
        [Self::Stop, Self::Reset, Self::Scan, Self::Info, Self::Health]
            .into_iter()
            .find(|request| request.command() == command)
    }

    fn with_payload(command: u8, payload: &[u8]) -> Option<Self> {
        match (command, payload) {
            (0x82, [working_mode, 0, 0, 0, 0]) => {
                Some(Self::ExpressScan { working_mode: *working_mode })
            }
            (0xf0, [low, high]) => Some(Self::MotorPwm(u16::from_le_bytes([*low, *high]))),
            (0xa8, [low, high]) => Some(Self::MotorSpeed(u16::from_le_bytes([*low, *high]))),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bytes(request: Request) -> Vec<u8> {
        let (bytes, length) = request.encode();
        bytes[..length].to_vec()
    }

    #[test]
    fn requests_are_those_of_the_makers_protocol_notes() {
        assert_eq!(bytes(Request::Stop), [0xa5, 0x25]);
        assert_eq!(bytes(Request::Reset), [0xa5, 0x40]);
        assert_eq!(bytes(Request::Scan), [0xa5, 0x20]);
        assert_eq!(bytes(Request::Info), [0xa5, 0x50]);
        assert_eq!(bytes(Request::Health), [0xa5, 0x52]);
        let express = bytes(Request::ExpressScan { working_mode: 0 });
        assert_eq!(express, [0xa5, 0x82, 0x05, 0, 0, 0, 0, 0, 0x22]);
        // The default duty cycle of the maker's software, 660 of 1023.
        assert_eq!(bytes(Request::MotorPwm(660)), [0xa5, 0xf0, 0x02, 0x94, 0x02, 0xc1]);
        assert_eq!(bytes(Request::MotorSpeed(600)), [0xa5, 0xa8, 0x02, 0x58, 0x02, 0x55]);
    }

    fn any_request() -> impl Strategy<Value = Request> {
        prop_oneof![
            Just(Request::Stop),
            Just(Request::Reset),
            Just(Request::Scan),
            Just(Request::Info),
            Just(Request::Health),
            any::<u8>().prop_map(|working_mode| Request::ExpressScan { working_mode }),
            any::<u16>().prop_map(Request::MotorPwm),
            any::<u16>().prop_map(Request::MotorSpeed),
        ]
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded_again(request in any_request()) {
            let sent = bytes(request);
            prop_assert_eq!(Request::decode(&sent), Some((Some(request), sent.len())));
            for length in 0..sent.len() {
                prop_assert_eq!(Request::decode(&sent[..length]), None);
            }
        }

        #[test]
        fn any_bytes_are_consumed_one_at_least_or_wait_for_more(
            bytes in proptest::collection::vec(any::<u8>(), 0..300),
        ) {
            if let Some((_, used)) = Request::decode(&bytes) {
                prop_assert!(used >= 1 && used <= bytes.len());
            }
        }
    }
}
