//! The interface between the base driver and a CAN bus: it sends frames, receives frames, and
//! reports the state of the bus.

use std::fmt;

use super::frame::CanFrame;

/// An event on the bus with its time of reception.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// Time of reception on the monotonic clock: the timestamp of the kernel or the controller
    /// where there is one.
    pub time_ns: u64,
    pub event: BusEvent,
}

/// A received frame, or a change in the state of the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BusEvent {
    /// A frame that another node sent.
    Frame(CanFrame),
    /// The controller detected errors on the bus.
    Errors {
        state: ErrorState,
        /// Transmit error counter (TEC), 0 if the controller does not report it.
        transmit: u8,
        /// Receive error counter (REC), 0 if the controller does not report it.
        receive: u8,
    },
    /// The controller left the bus after 256 transmit errors. It sends nothing until it is
    /// restarted.
    BusOff,
    /// The controller rejoined the bus after a bus-off.
    Restarted,
    /// No node acknowledged a frame. The cause is the cable, the termination, the bit rate, or that
    /// every other node is off.
    NoAcknowledge,
    /// Received frames were lost because a receive buffer overflowed.
    Overflow,
    /// Any other error frame.
    Noise,
    /// The interface is absent or down. The bus tries to open it again.
    Gone,
    /// The interface is open again.
    Back,
}

/// The error states of ISO 11898-1 other than bus-off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ErrorState {
    /// Error counters are low; the controller takes part fully.
    #[default]
    Active,
    /// An error counter exceeds 96.
    Warning,
    /// An error counter exceeds 127, so the controller may no longer signal errors.
    Passive,
}

/// Why a frame could not be sent. The bus never sends it later, because it would be stale by then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SendProblem {
    /// The transmit queue is full (`ENOBUFS`, `EAGAIN`): the bus is overloaded or bus-off, or no
    /// node acknowledges.
    Full,
    /// The interface is down (`ENETDOWN`).
    Down,
    /// The interface does not exist (`ENODEV`, `ENXIO`, closed socket).
    Gone,
    /// Any other error code of the operating system (`errno`).
    Code(i32),
}

impl fmt::Display for SendProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full => f.write_str(
                "the transmit queue is full; check cable, termination, bit rate and `restart-ms`",
            ),
            Self::Down => f.write_str(
                "the interface is down; run `ip link set <name> up type can bitrate <rate> \
                 restart-ms 100`",
            ),
            Self::Gone => f.write_str(
                "the interface does not exist; plug the adapter in, or name another \
                    bus",
            ),
            Self::Code(code) => write!(f, "operating system error {code}"),
        }
    }
}

/// A CAN bus. No method blocks. An implementation queues nothing beyond the kernel's own queue and
/// never sends a frame twice.
pub trait CanBus {
    /// Sends a frame now or not at all.
    ///
    /// # Errors
    /// The reason why the frame was not sent. It is dropped then.
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem>;

    /// Returns the oldest pending event. Also reopens a lost interface when its back-off is over.
    /// `now_ns` is the monotonic time.
    fn receive(&mut self, now_ns: u64) -> Option<Received>;

    /// Drops the frames that are queued for sending, as far as the operating system permits. See
    /// [`SocketBus`](super::SocketBus) for the frames that Linux may still send.
    fn drop_pending(&mut self);

    /// The configured name of the bus, for messages.
    fn name(&self) -> &str;
}

impl<B: CanBus + ?Sized> CanBus for Box<B> {
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem> {
        (**self).send(frame)
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        (**self).receive(now_ns)
    }

    fn drop_pending(&mut self) {
        (**self).drop_pending();
    }

    fn name(&self) -> &str {
        (**self).name()
    }
}

/// A back-off whose delay doubles from 100 ms to 2 s: long enough that a broken bus costs no
/// processor time, short enough that a repaired one is in use again within seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backoff {
    wait_ns: u64,
    until_ns: u64,
}

impl Backoff {
    pub const FIRST_NS: u64 = 100_000_000;
    pub const LONGEST_NS: u64 = 2_000_000_000;

    #[must_use]
    pub fn new() -> Self {
        Self { wait_ns: Self::FIRST_NS, until_ns: 0 }
    }

    /// Starts a delay now, and doubles the next one.
    pub fn wait(&mut self, now_ns: u64) {
        self.until_ns = now_ns.saturating_add(self.wait_ns);
        self.wait_ns = (self.wait_ns * 2).min(Self::LONGEST_NS);
    }

    /// Whether the delay is over.
    #[must_use]
    pub fn is_over(&self, now_ns: u64) -> bool {
        now_ns >= self.until_ns
    }

    /// The monotonic time at which the delay is over.
    #[must_use]
    pub fn until_ns(&self) -> u64 {
        self.until_ns
    }

    /// Ends the delay, and makes the next one the shortest again.
    pub fn reset(&mut self) {
        *self = Self::new();
    }
}

impl Default for Backoff {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_up_to_two_seconds_and_start_again_after_a_reset() {
        let mut backoff = Backoff::new();
        let mut delays_ms = Vec::new();
        for _ in 0..7 {
            backoff.wait(0);
            delays_ms.push(backoff.until_ns() / 1_000_000);
        }
        assert_eq!(delays_ms, [100, 200, 400, 800, 1600, 2000, 2000]);
        backoff.reset();
        assert!(backoff.is_over(0));
    }
}
