//! The line DTR of a serial port.

use std::os::fd::AsFd;

use rustix::io::Errno;
use rustix::ioctl::{Opcode, Setter, ioctl};

/// `TIOCMBIS` and `TIOCMBIC` set and clear modem lines, `TIOCM_DTR` is the bit of DTR
/// (Linux, asm-generic/ioctls.h and asm-generic/termios.h).
const TIOCMBIS: Opcode = 0x5416;
const TIOCMBIC: Opcode = 0x5417;
const TIOCM_DTR: i32 = 0x002;

/// Sets or clears DTR. Ports without modem lines, such as ptys, refuse it.
pub(super) fn set_dtr(fd: impl AsFd, on: bool) -> Result<(), Errno> {
    // SAFETY: Both operations read one `int` from the given address and write nothing, which is
    // what `Setter<_, i32>` passes.
    unsafe {
        if on {
            ioctl(fd, Setter::<TIOCMBIS, i32>::new(TIOCM_DTR))
        } else {
            ioctl(fd, Setter::<TIOCMBIC, i32>::new(TIOCM_DTR))
        }
    }
}
