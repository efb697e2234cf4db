//! The protocol and driver of LDROBOT's LD06 and LD19 (LDROBOT, "LD06 development manual", and the
//! same for the LD19, whose packets are equal).
//!
//! The scanner only sends: 47-byte packets of 12 points at 230,400 bit/s, from the moment it has
//! power. It rotates clockwise ten times a second unless its PWM input says otherwise. [`Packet`] and
//! [`Decoder`] do no I/O and allocate nothing.
//!
//! The checksum detects every single flipped bit, and one in 256 packets of noise passes it by chance;
//! angles that the scanner cannot have sent are refused in addition.

mod config;
mod crc;
mod decoder;
mod device;
mod error;
mod packet;

pub use config::Ld06Config;
pub use decoder::{ACCURACY_M, Decoder, RANGE_M};
pub use device::open;
pub use error::PacketError;
pub use packet::{PACKET_BYTES, POINTS, Packet, Point, may_begin};

/// Bit rate of the scanner's data line.
pub const BAUD: u32 = 230_400;
