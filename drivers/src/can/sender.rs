//! Which motor controller sent a frame, from what it sends unasked. Nothing is sent to find out: a request of one protocol is a
//! command of another.

use super::config::Protocol;
use super::frame::{CanFrame, CanId};

/// A motor controller on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Sender {
    /// The protocol that it speaks.
    pub protocol: Protocol,
    /// Number of its node on the bus.
    pub node: u8,
}

/// The command of an ODrive's heartbeat, in the lower five bits of the id ("CAN Protocol", docs.odriverobotics.com).
const ODRIVE_HEARTBEAT: u16 = 0x01;
/// The ids of CANopen's heartbeats are this plus the node (CiA 301).
const CANOPEN_HEARTBEAT: u16 = 0x700;
/// The packet "status" of a VESC, above its node in the id (`comm_can.c` of its firmware).
const VESC_STATUS: u32 = 9;

/// The controller that sent this heartbeat or status. `None` for any other frame.
#[must_use]
pub fn sender(frame: &CanFrame) -> Option<Sender> {
    if frame.is_remote() {
        return None;
    }
    match (frame.id(), frame.length()) {
        // A heartbeat of CANopen has one byte, an ODrive's has seven or eight.
        (CanId::Standard(id), 1) if (1..=0x7f).contains(&(id.wrapping_sub(CANOPEN_HEARTBEAT))) => {
            Some(Sender { protocol: Protocol::Cia402, node: (id & 0x7f) as u8 })
        }
        (CanId::Standard(id), 7 | 8) if id & 0x1f == ODRIVE_HEARTBEAT => {
            Some(Sender { protocol: Protocol::Odrive, node: (id >> 5) as u8 })
        }
        (CanId::Extended(id), 8) if id >> 8 == VESC_STATUS => {
            Some(Sender { protocol: Protocol::Vesc, node: (id & 0xff) as u8 })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_protocol_is_known_by_its_heartbeat_and_other_frames_name_no_controller() {
        for (id, length, protocol, node) in [
            (CanId::Standard(0x061), 8, Protocol::Odrive, 3),
            (CanId::Standard(0x703), 1, Protocol::Cia402, 3),
            (CanId::Standard(0x701), 8, Protocol::Odrive, 56),
            (CanId::Extended(0x955), 8, Protocol::Vesc, 0x55),
        ] {
            assert_eq!(sender_of(id, length), Some(Sender { protocol, node }), "{id}");
        }
        for (id, length) in [
            (CanId::Standard(0x069), 8),
            (CanId::Standard(0x700), 1),
            (CanId::Standard(0x583), 8),
            (CanId::Extended(0x1055), 8),
            (CanId::Standard(0), 0),
        ] {
            assert_eq!(sender_of(id, length), None, "{id}");
        }
        let remote = CanFrame::remote(CanId::Standard(0x061), 8).unwrap();
        assert_eq!(sender(&remote), None);
    }

    fn sender_of(id: CanId, length: usize) -> Option<Sender> {
        sender(&CanFrame::new(id, &[0; 8][..length]).unwrap())
    }
}
