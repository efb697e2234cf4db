//! A CAN interface of the Linux kernel (SocketCAN).

use std::io::{ErrorKind as IoErrorKind, Write};
use std::time::{Duration, SystemTime};

use rustix::io::Errno;
use rustix::net::sockopt;
use socketcan::{CanSocket, Socket, SocketOptions, timestamp};

use super::bus::{Backoff, BusEvent, CanBus, Received, SendProblem};
use super::frame::CanFrame;
use super::record;
use super::stamp::ReceiveClock;
use monotonic_clock::{monotonic_ns, realtime_ahead_ns};

/// Size of the send buffer in bytes. The kernel doubles it; at about 768 bytes of bookkeeping per
/// frame it holds ten frames, which are two control ticks.
const SEND_BUFFER: usize = 4096;

/// A SocketCAN interface. It is opened by name, and reopened by name after it disappeared.
///
/// *Frames that may still be sent after a bus-off.* Closing the socket drops the frames in the
/// socket's buffer. Frames that the queueing discipline or the controller's mailboxes have already
/// taken are out of reach: Linux drops them when the carrier goes down, up to a second later, or
/// sends them after a quick restart. Therefore the send buffer holds only two control ticks, the
/// driver's first frames after a bus-off command zero velocity, and the motors' own watchdogs have
/// expired by then.
///
/// *Restart.* The kernel restarts a bus-off controller after the interface's `restart-ms` (`ip link
/// set can0 type can restart-ms 100`). This driver has no permission to restart it and does not
/// need it.
#[derive(Debug)]
pub struct SocketBus {
    name: String,
    socket: Option<CanSocket>,
    clock: ReceiveClock,
    retry: Backoff,
    was_open: bool,
}

impl SocketBus {
    /// Uses the interface of this name, which may appear later.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            socket: None,
            clock: ReceiveClock::default(),
            retry: Backoff::new(),
            was_open: true,
        }
    }

    fn reopen(&mut self, now_ns: u64) -> Option<Received> {
        if self.retry.is_over(now_ns) {
            match open(&self.name) {
                Ok(socket) => {
                    self.clock = ReceiveClock::new(now_ns, socket.has_hw_timestamps());
                    self.socket = Some(socket);
                    self.retry.reset();
                    self.was_open = true;
                    return Some(Received { time_ns: now_ns, event: BusEvent::Back });
                }
                Err(_) => self.retry.wait(now_ns),
            }
        }
        // The loss is reported once.
        std::mem::take(&mut self.was_open)
            .then_some(Received { time_ns: now_ns, event: BusEvent::Gone })
    }

    fn close(&mut self, now_ns: u64) -> Received {
        self.socket = None;
        self.was_open = false;
        self.retry.wait(now_ns);
        Received { time_ns: now_ns, event: BusEvent::Gone }
    }

    fn time_ns(&mut self, stamps: &socketcan::CanTimestamps, now_ns: u64) -> u64 {
        let Some(software) = stamps.sw else { return now_ns };
        let since_1970 = software.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO);
        let software_ns = since_1970.as_nanos() as i64 - realtime_ahead_ns();
        let software_ns = u64::try_from(software_ns).unwrap_or(0);
        let hardware_ns = stamps.hw.map(|hardware| hardware.as_nanos() as u64);
        self.clock.time_ns(software_ns, hardware_ns, now_ns)
    }
}

/// Opens a non-blocking socket that receives error frames and timestamps. Fails when the interface
/// is down.
fn open(name: &str) -> std::io::Result<CanSocket> {
    let socket = CanSocket::open(name)?;
    socket.set_nonblocking(true)?;
    // Error frames are off by default, and without them a bus-off would never be noticed.
    socket.set_error_filter_accept_all()?;
    socket.set_timestamping(
        timestamp::SOF_TIMESTAMPING_RX_SOFTWARE
            | timestamp::SOF_TIMESTAMPING_SOFTWARE
            | timestamp::SOF_TIMESTAMPING_RX_HARDWARE
            | timestamp::SOF_TIMESTAMPING_RAW_HARDWARE
            | timestamp::SOF_TIMESTAMPING_OPT_CMSG,
    )?;
    sockopt::set_socket_send_buffer_size(&socket, SEND_BUFFER)?;
    sockopt::socket_error(&socket)??;
    Ok(socket)
}

fn classify(error: &std::io::Error) -> SendProblem {
    match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::NOBUFS | Errno::AGAIN) => SendProblem::Full,
        Some(Errno::NETDOWN) => SendProblem::Down,
        Some(Errno::NODEV | Errno::NXIO | Errno::BADF | Errno::NOTCONN) => SendProblem::Gone,
        Some(code) => SendProblem::Code(code.raw_os_error()),
        None => SendProblem::Code(0),
    }
}

impl CanBus for SocketBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem> {
        let socket = self.socket.as_mut().ok_or(SendProblem::Gone)?;
        // This is a single `write`, because `write_frame_insist` spins on a full queue.
        match socket.write(&record::encode(frame)) {
            Ok(record::RECORD_BYTES) => Ok(()),
            Ok(_) => Err(SendProblem::Code(0)),
            Err(error) => Err(classify(&error)),
        }
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        let Some(socket) = &self.socket else { return self.reopen(now_ns) };
        match socket.read_frame_with_timestamps() {
            Ok((frame, stamps)) => {
                let raw = frame.as_ref();
                let event =
                    record::event(raw.can_id, raw.can_dlc, &raw.data).unwrap_or(BusEvent::Noise);
                Some(Received { time_ns: self.time_ns(&stamps, now_ns.max(monotonic_ns())), event })
            }
            Err(error)
                if matches!(error.kind(), IoErrorKind::WouldBlock | IoErrorKind::Interrupted) =>
            {
                self.clock.emptied(now_ns);
                None
            }
            // A CAN FD frame, which none of our nodes sends.
            Err(error) if error.kind() == IoErrorKind::InvalidData => {
                Some(Received { time_ns: now_ns, event: BusEvent::Noise })
            }
            Err(_) => Some(self.close(now_ns)),
        }
    }

    fn drop_pending(&mut self) {
        // The next `receive` opens the socket again.
        self.socket = None;
        self.retry.reset();
    }

    fn name(&self) -> &str {
        &self.name
    }
}
