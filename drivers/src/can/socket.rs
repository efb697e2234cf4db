//! A CAN interface of the Linux kernel.

use std::io::{ErrorKind as IoErrorKind, Write};
use std::time::{Duration, SystemTime};

use rustix::io::Errno;
use rustix::net::sockopt;
use socketcan::{CanSocket, Socket, SocketOptions, timestamp};

use super::bus::{Backoff, BusEvent, CanBus, Received, SendProblem};
use super::frame::CanFrame;
use super::record;
use super::stamp::HardwareClock;
use monotonic_clock::{monotonic_ns, realtime_ahead_ns};

/// The kernel doubles it; at some 768 bytes of bookkeeping per frame that is ten frames, two turns of the loop.
const SEND_BUFFER: usize = 4096;

/// A SocketCAN interface, opened by name and opened again by name whenever it had gone.
///
/// *What may still be sent after a bus-off.* Closing the socket drops what the socket holds. What the queueing discipline or
/// the controller's mailboxes took already is theirs: Linux drops it when the carrier goes, which may come up to a second
/// later, or sends it after a quick restart. So the send buffer holds two turns of the loop, the driver's first frames after
/// a bus-off are zeros, and the motors' own watchdogs have expired by then.
///
/// *Restart.* A controller that is bus-off comes back by `restart-ms` of the interface (`ip link set can0 type can restart-ms
/// 100`); this driver has no right to restart it and needs none.
#[derive(Debug)]
pub struct SocketBus {
    name: String,
    socket: Option<CanSocket>,
    hardware: Option<HardwareClock>,
    retry: Backoff,
    was_open: bool,
}

impl SocketBus {
    /// The interface of that name. It need not be there yet.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            socket: None,
            hardware: None,
            retry: Backoff::new(),
            was_open: true,
        }
    }

    fn reopen(&mut self, now_ns: u64) -> Option<Received> {
        if self.retry.is_over(now_ns) {
            match open(&self.name) {
                Ok(socket) => {
                    self.hardware = socket.has_hw_timestamps().then(HardwareClock::default);
                    self.socket = Some(socket);
                    self.retry.reset();
                    self.was_open = true;
                    return Some(Received { time_ns: now_ns, event: BusEvent::Back });
                }
                Err(_) => self.retry.wait(now_ns),
            }
        }
        // Told once.
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
        let since_1970 = |time: SystemTime| {
            time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO)
        };
        let Some(software) = stamps.sw else { return now_ns };
        let software_ns = since_1970(software).as_nanos() as i64 - realtime_ahead_ns();
        let software_ns = u64::try_from(software_ns).unwrap_or(0).min(now_ns);
        match (&mut self.hardware, stamps.hw) {
            (Some(clock), Some(hardware)) => {
                clock.monotonic_ns(hardware.as_nanos() as u64, software_ns)
            }
            _ => software_ns,
        }
    }
}

/// Opened, not blocking, with error frames and time stamps; an error when the interface is down.
fn open(name: &str) -> std::io::Result<CanSocket> {
    let socket = CanSocket::open(name)?;
    socket.set_nonblocking(true)?;
    // Off by default, and without them a bus-off is never seen.
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
        // One `write`: never `write_frame_insist`, which spins on a full queue.
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
                None
            }
            // A CAN FD frame: somebody else's.
            Err(error) if error.kind() == IoErrorKind::InvalidData => {
                Some(Received { time_ns: now_ns, event: BusEvent::Noise })
            }
            Err(_) => Some(self.close(now_ns)),
        }
    }

    fn drop_pending(&mut self) {
        // Closed here, opened again by the next `receive`.
        self.socket = None;
        self.retry.reset();
    }

    fn name(&self) -> &str {
        &self.name
    }
}
