//! The project's own frames on the bus, described in `embodied.dbc`. The host publishes its command
//! and the state of the base, for loggers and a safety board; the safety board sends its inputs.
//! Each frame has a counter and a checksum: CRC-8/SAE-J1850 over the id (four bytes, low byte
//! first) and every byte except the checksum itself.
//!
//! The ids have 29 bits, because every 11-bit id belongs to a node of ODrive or CANopen, and every
//! 29-bit id up to 0xFFFF to a VESC.

use hal::Twist2;

use super::frame::{CanFrame, CanId};
use super::protocol::crc::crc8;

/// Identifier of the frame of [`BaseCommand`], 29 bits.
pub const COMMAND_ID: u32 = 0x00ed_0000;
/// Identifier of the frame of [`BaseState`], 29 bits.
pub const STATE_ID: u32 = 0x00ed_0001;
/// Identifier of the frame of [`SafetyInput`], 29 bits.
pub const SAFETY_ID: u32 = 0x00ed_0002;

/// The host's command to the wheels, sent once per tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BaseCommand {
    /// Counts the ticks, 0 to 15.
    pub counter: u8,
    pub armed: bool,
    /// The base is stopped by a trip.
    pub stop: bool,
    /// Age of the plan, saturated at 65,535 ms.
    pub plan_age_ms: u16,
    /// The velocity after the limiter; resolution 1 mm/s and 1 mrad/s, saturated.
    pub twist: Twist2,
}

/// The state of the base as the host knows it, sent with every tenth tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BaseState {
    /// Counts these frames, 0 to 15.
    pub counter: u8,
    /// [`Phase`](super::Phase) as a number: 0 disarmed, 1 arming, 2 armed, 3 disarming, 4 tripped.
    pub phase: u8,
    /// [`Trip::number`](super::Trip::number), 0 for none.
    pub trip: u8,
    /// The emergency stop is pressed.
    pub estop: bool,
    /// A bumper is pressed or a wheel is stalled.
    pub contact: bool,
    pub twist: Twist2,
}

/// The inputs of a safety board: its emergency stop, bumper switches and cliff sensors.
///
/// The emergency stop has two channels with opposite levels, `EStop` and `Released` of
/// `embodied.dbc`. Equal levels mean a broken wire or a contact that sticks, and count as pressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SafetyInput {
    /// Counts these frames, 0 to 15.
    pub counter: u8,
    /// The emergency stop is pressed, or its two channels contradict each other.
    pub estop: bool,
    pub bumper: bool,
    /// A cliff sensor sees no floor.
    pub cliff: bool,
}

/// Why a frame is not one of these messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageError {
    /// The frame has another id or length, or is a remote frame.
    Shape,
    /// The checksum is wrong.
    Checksum,
}

fn to_milli(value: f64) -> [u8; 2] {
    // `as` saturates, and converts NaN to 0; the callers pass finite numbers.
    ((value * 1e3).round() as i16).to_le_bytes()
}

fn from_milli(low: u8, high: u8) -> f64 {
    f64::from(i16::from_le_bytes([low, high])) * 1e-3
}

fn with_checksum(id: u32, mut data: [u8; 8], length: usize) -> CanFrame {
    data[0] = checksum(id, data.get(1..length).unwrap_or_default());
    CanFrame::extended_short(id, data, length)
}

fn checksum(id: u32, rest: &[u8]) -> u8 {
    crc8(id.to_le_bytes().into_iter().chain(rest.iter().copied()))
}

fn checked_payload(id: u32, frame: &CanFrame, length: usize) -> Result<&[u8], MessageError> {
    let data = frame.data();
    match data {
        [sum, rest @ ..] if frame.id() == CanId::Extended(id) && data.len() == length => {
            if *sum == checksum(id, rest) { Ok(rest) } else { Err(MessageError::Checksum) }
        }
        _ => Err(MessageError::Shape),
    }
}

impl BaseCommand {
    #[must_use]
    pub fn encode(&self) -> CanFrame {
        let flags = self.counter & 0x0f | u8::from(self.armed) << 4 | u8::from(self.stop) << 5;
        let [a0, a1] = self.plan_age_ms.to_le_bytes();
        let [v0, v1] = to_milli(self.twist.linear_mps);
        let [w0, w1] = to_milli(self.twist.angular_radps);
        with_checksum(COMMAND_ID, [0, flags, a0, a1, v0, v1, w0, w1], 8)
    }

    /// Decodes a frame.
    ///
    /// # Errors
    /// When the frame is another message or fails its checksum.
    pub fn decode(frame: &CanFrame) -> Result<Self, MessageError> {
        let [flags, a0, a1, v0, v1, w0, w1] = *checked_payload(COMMAND_ID, frame, 8)? else {
            return Err(MessageError::Shape);
        };
        Ok(Self {
            counter: flags & 0x0f,
            armed: flags & 0x10 != 0,
            stop: flags & 0x20 != 0,
            plan_age_ms: u16::from_le_bytes([a0, a1]),
            twist: Twist2 { linear_mps: from_milli(v0, v1), angular_radps: from_milli(w0, w1) },
        })
    }
}

impl BaseState {
    #[must_use]
    pub fn encode(&self) -> CanFrame {
        let first = self.counter & 0x0f | self.phase << 4;
        let flags = u8::from(self.estop) | u8::from(self.contact) << 1;
        let [v0, v1] = to_milli(self.twist.linear_mps);
        let [w0, w1] = to_milli(self.twist.angular_radps);
        with_checksum(STATE_ID, [0, first, self.trip, flags, v0, v1, w0, w1], 8)
    }

    /// Decodes a frame.
    ///
    /// # Errors
    /// When the frame is another message or fails its checksum.
    pub fn decode(frame: &CanFrame) -> Result<Self, MessageError> {
        let [first, trip, flags, v0, v1, w0, w1] = *checked_payload(STATE_ID, frame, 8)? else {
            return Err(MessageError::Shape);
        };
        Ok(Self {
            counter: first & 0x0f,
            phase: first >> 4,
            trip,
            estop: flags & 1 != 0,
            contact: flags & 2 != 0,
            twist: Twist2 { linear_mps: from_milli(v0, v1), angular_radps: from_milli(w0, w1) },
        })
    }
}

impl SafetyInput {
    #[must_use]
    pub fn encode(&self) -> CanFrame {
        let flags = self.counter & 0x0f
            | u8::from(self.estop) << 4
            | u8::from(self.bumper) << 5
            | u8::from(!self.estop) << 6
            | u8::from(self.cliff) << 7;
        with_checksum(SAFETY_ID, [0, flags, 0, 0, 0, 0, 0, 0], 2)
    }

    /// Decodes a frame.
    ///
    /// # Errors
    /// When the frame is another message or fails its checksum.
    pub fn decode(frame: &CanFrame) -> Result<Self, MessageError> {
        let [flags] = *checked_payload(SAFETY_ID, frame, 2)? else {
            return Err(MessageError::Shape);
        };
        let pressed = flags & 0x10 != 0;
        let released = flags & 0x40 != 0;
        Ok(Self {
            counter: flags & 0x0f,
            estop: pressed || !released,
            bumper: flags & 0x20 != 0,
            cliff: flags & 0x80 != 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A twist of `v` mm/s and `w` mrad/s.
    fn milli_twist(v: i16, w: i16) -> Twist2 {
        Twist2 { linear_mps: f64::from(v) * 1e-3, angular_radps: f64::from(w) * 1e-3 }
    }

    proptest! {
        #[test]
        fn a_command_is_decoded_as_it_was_encoded(
            counter in 0u8..16,
            armed: bool,
            stop: bool,
            plan_age_ms: u16,
            v in -32_768i16..=32_767,
            w in -32_768i16..=32_767,
        ) {
            let twist = milli_twist(v, w);
            let command = BaseCommand { counter, armed, stop, plan_age_ms, twist };
            prop_assert_eq!(BaseCommand::decode(&command.encode()), Ok(command));
        }

        #[test]
        fn a_state_is_decoded_as_it_was_encoded(
            counter in 0u8..16,
            phase in 0u8..5,
            trip: u8,
            estop: bool,
            contact: bool,
            v: i16,
            w: i16,
        ) {
            let twist = milli_twist(v, w);
            let state = BaseState { counter, phase, trip, estop, contact, twist };
            prop_assert_eq!(BaseState::decode(&state.encode()), Ok(state));
        }

        #[test]
        fn one_or_two_flipped_bits_fail_the_checksum(
            counter in 0u8..16,
            v: i16,
            a in 0usize..64,
            b in 0usize..64,
        ) {
            let twist = milli_twist(v, 0);
            let frame = BaseCommand { counter, twist, ..BaseCommand::default() }.encode();
            let mut data = *frame.eight().expect("8 bytes");
            data[a / 8] ^= 1 << (a % 8);
            if a != b {
                data[b / 8] ^= 1 << (b % 8);
            }
            let broken = CanFrame::extended_short(COMMAND_ID, data, 8);
            prop_assert_eq!(BaseCommand::decode(&broken), Err(MessageError::Checksum));
        }
    }

    #[test]
    fn the_emergency_stop_is_released_only_if_both_channels_say_so() {
        for (flags, pressed) in [(0x00, true), (0x10, true), (0x40, false), (0x50, true)] {
            let frame = with_checksum(SAFETY_ID, [0, flags, 0, 0, 0, 0, 0, 0], 2);
            assert_eq!(SafetyInput::decode(&frame).map(|input| input.estop), Ok(pressed));
        }
    }

    #[test]
    fn the_same_bytes_with_another_id_are_refused() {
        let command = BaseCommand::default().encode();
        let disguised = CanFrame::extended_short(STATE_ID, *command.eight().expect("8 bytes"), 8);
        assert_eq!(BaseState::decode(&disguised), Err(MessageError::Checksum));
        assert_eq!(SafetyInput::decode(&command), Err(MessageError::Shape));
    }
}
