//! The 16 bytes of Linux's `struct can_frame` (`linux/can.h`), including error frames
//! (`linux/can/error.h`). SocketCAN reads and writes these records, and [`UnixBus`](super::UnixBus)
//! transfers them over its socket.
//!
//! ```text
//! 0..4   identifier, host byte order; bit 31 extended, bit 30 remote, bit 29 error
//! 4      length, 0 to 8
//! 5..8   zero
//! 8..16  data
//! ```

use super::bus::{BusEvent, ErrorState};
use super::frame::{CanFrame, CanId};

pub const RECORD_BYTES: usize = 16;

const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;

/// Error classes in the identifier of an error frame.
mod class {
    pub const CONTROLLER: u32 = 0x004;
    pub const NO_ACK: u32 = 0x020;
    pub const BUS_OFF: u32 = 0x040;
    pub const RESTARTED: u32 = 0x100;
}

/// Controller problems in byte 1 of an error frame.
mod controller {
    pub const OVERFLOW: u8 = 0x01 | 0x02;
    pub const WARNING: u8 = 0x04 | 0x08;
    pub const PASSIVE: u8 = 0x10 | 0x20;
    pub const ACTIVE: u8 = 0x40;
}

/// Encodes a frame as a record.
#[must_use]
pub fn encode(frame: &CanFrame) -> [u8; RECORD_BYTES] {
    let id = match frame.id() {
        CanId::Standard(id) => u32::from(id),
        CanId::Extended(id) => id | EXTENDED,
    };
    let id = if frame.is_remote() { id | REMOTE } else { id };
    let mut record = [0; RECORD_BYTES];
    record[..4].copy_from_slice(&id.to_ne_bytes());
    record[4] = frame.length();
    for (byte, value) in record[8..].iter_mut().zip(frame.data()) {
        *byte = *value;
    }
    record
}

/// Decodes a record. `None` when it is not a classic CAN frame.
#[must_use]
pub fn decode(record: &[u8]) -> Option<BusEvent> {
    let record: &[u8; RECORD_BYTES] = record.try_into().ok()?;
    let [i0, i1, i2, i3, length, _, _, _, data @ ..] = record;
    event(u32::from_ne_bytes([*i0, *i1, *i2, *i3]), *length, data)
}

/// Decodes the fields of a record. `None` when they are not those of a classic CAN frame.
#[must_use]
pub fn event(id: u32, length: u8, data: &[u8; 8]) -> Option<BusEvent> {
    if id & ERROR != 0 {
        return Some(error(id, data));
    }
    let number = id & 0x1fff_ffff;
    let can_id = if id & EXTENDED != 0 {
        CanId::Extended(number)
    } else {
        CanId::Standard(u16::try_from(number).ok()?)
    };
    let frame = match id & REMOTE != 0 {
        true => CanFrame::remote(can_id, length),
        false => CanFrame::new(can_id, data.get(..usize::from(length))?),
    };
    frame.map(BusEvent::Frame)
}

/// The record with which a CAN controller's driver reports a bus-off, for simulators.
#[must_use]
pub fn bus_off_record() -> [u8; RECORD_BYTES] {
    let mut record = [0; RECORD_BYTES];
    record[..4].copy_from_slice(&(ERROR | class::BUS_OFF).to_ne_bytes());
    record[4] = 8;
    record
}

/// The most severe event of an error frame, because one frame may report several.
fn error(id: u32, data: &[u8; 8]) -> BusEvent {
    if id & class::BUS_OFF != 0 {
        return BusEvent::BusOff;
    }
    if id & class::RESTARTED != 0 {
        return BusEvent::Restarted;
    }
    if id & class::CONTROLLER != 0 {
        let [_, problem, .., transmit, receive] = *data;
        // The counters are bytes 6 and 7; drivers that do not know them leave them 0.
        let state = match problem {
            problem if problem & controller::PASSIVE != 0 => Some(ErrorState::Passive),
            problem if problem & controller::WARNING != 0 => Some(ErrorState::Warning),
            problem if problem & controller::ACTIVE != 0 => Some(ErrorState::Active),
            _ => None,
        };
        if let Some(state) = state {
            return BusEvent::Errors { state, transmit, receive };
        }
        if problem & controller::OVERFLOW != 0 {
            return BusEvent::Overflow;
        }
    }
    if id & class::NO_ACK != 0 { BusEvent::NoAcknowledge } else { BusEvent::Noise }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame() -> impl Strategy<Value = CanFrame> {
        let id = prop_oneof![
            (0u16..0x800).prop_map(CanId::Standard),
            (0u32..0x2000_0000).prop_map(CanId::Extended),
        ];
        (id, any::<bool>(), proptest::collection::vec(any::<u8>(), 0..=8)).prop_map(
            |(id, remote, data)| {
                let frame = if remote {
                    CanFrame::remote(id, data.len() as u8)
                } else {
                    CanFrame::new(id, &data)
                };
                frame.expect("the strategy makes valid frames")
            },
        )
    }

    proptest! {
        #[test]
        fn a_frame_is_decoded_as_it_was_encoded(frame in frame()) {
            prop_assert_eq!(decode(&encode(&frame)), Some(BusEvent::Frame(frame)));
        }

        #[test]
        fn only_records_of_16_bytes_are_decoded(
            bytes in proptest::collection::vec(any::<u8>(), 0..24),
        ) {
            if decode(&bytes).is_some() {
                prop_assert_eq!(bytes.len(), RECORD_BYTES);
            }
        }
    }

    fn error_record(id: u32, data: [u8; 8]) -> Vec<u8> {
        [&(id | ERROR).to_ne_bytes()[..], &[8, 0, 0, 0], &data].concat()
    }

    #[test]
    fn error_frames_report_the_state_of_the_controller() {
        assert_eq!(decode(&bus_off_record()), Some(BusEvent::BusOff));
        assert_eq!(decode(&error_record(0x100, [0; 8])), Some(BusEvent::Restarted));
        assert_eq!(decode(&error_record(0x20, [0; 8])), Some(BusEvent::NoAcknowledge));
        assert_eq!(
            decode(&error_record(0x04, [0, 0x01, 0, 0, 0, 0, 0, 0])),
            Some(BusEvent::Overflow)
        );
        let passive = BusEvent::Errors { state: ErrorState::Passive, transmit: 128, receive: 3 };
        assert_eq!(decode(&error_record(0x204, [0, 0x20, 0, 0, 0, 0, 128, 3])), Some(passive));
    }

    #[test]
    fn a_standard_id_above_11_bits_and_a_length_above_8_are_refused() {
        let mut record = encode(&CanFrame::standard(1, [0; 8]));
        record[4] = 9;
        assert_eq!(decode(&record), None);
        record[4] = 8;
        record[..4].copy_from_slice(&0x800u32.to_ne_bytes());
        assert_eq!(decode(&record), None);
    }
}
