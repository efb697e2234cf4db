//! A CAN bus as the base driver sees it: frames go in and come out, and the bus tells how it is.

use std::fmt;

use super::frame::CanFrame;

/// What came from the bus, and when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// When it came, monotonic; the kernel's or the controller's own time stamp where there is one.
    pub time_ns: u64,
    /// What came.
    pub event: BusEvent,
}

/// A frame, or news of the bus itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BusEvent {
    /// A frame of another node.
    Frame(CanFrame),
    /// The controller took part in errors: its state, and its error counters where it tells them.
    Errors {
        /// How bad.
        state: ErrorState,
        /// Transmit error counter (TEC), 0 where it is not told.
        transmit: u8,
        /// Receive error counter (REC), 0 where it is not told.
        receive: u8,
    },
    /// The controller has left the bus after 256 transmit errors. Nothing goes out until it is restarted.
    BusOff,
    /// The controller is back on the bus after a bus-off.
    Restarted,
    /// Nobody acknowledged a frame: cable, termination, bit rate, or everybody else is off.
    NoAcknowledge,
    /// Frames were lost because somebody did not fetch them in time.
    Overflow,
    /// Any other error frame.
    Noise,
    /// The interface is gone or down; the bus tries to open it again.
    Gone,
    /// The interface is open again.
    Back,
}

/// ISO 11898-1 error states short of bus-off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ErrorState {
    /// Takes part fully.
    #[default]
    Active,
    /// A counter has passed 96.
    Warning,
    /// A counter has passed 127: it may no longer signal errors.
    Passive,
}

/// Why a frame did not go out. It is never repeated by the bus: by then it is old.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SendProblem {
    /// The transmit queue is full (`ENOBUFS`, `EAGAIN`): the bus is jammed, off, or nobody acknowledges.
    Full,
    /// The interface is down (`ENETDOWN`).
    Down,
    /// The interface does not exist (`ENODEV`, `ENXIO`, closed socket).
    Gone,
    /// Any other error code of the operating system.
    Code(i32),
}

impl fmt::Display for SendProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full => f.write_str(
                "its transmit queue is full; check cable, termination, bit rate and `restart-ms`",
            ),
            Self::Down => f.write_str(
                "it is down; `ip link set <name> up type can bitrate <rate> restart-ms 100`",
            ),
            Self::Gone => {
                f.write_str("it does not exist; plug the adapter in, or name another bus")
            }
            Self::Code(code) => write!(f, "error {code} of the operating system"),
        }
    }
}

/// A CAN bus. Nothing blocks, nothing is queued beyond what the kernel holds, nothing is sent twice.
pub trait CanBus {
    /// Sends a frame now or not at all.
    ///
    /// # Errors
    /// Why it did not go out.
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem>;

    /// The oldest event that was not fetched yet. Also opens the interface again when it had gone and its waiting time is over;
    /// `now_ns` is monotonic.
    fn receive(&mut self, now_ns: u64) -> Option<Received>;

    /// Drops what waits to be sent, as far as the operating system lets it. See [`SocketBus`](super::SocketBus) for what Linux
    /// may still send.
    fn drop_pending(&mut self);

    /// The name that people know it by.
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

/// Waiting times that double from 100 ms to 2 s: long enough that a broken bus costs no processor time, short enough that a
/// repaired one is back before a person looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backoff {
    wait_ns: u64,
    until_ns: u64,
}

impl Backoff {
    /// The shortest wait.
    pub const FIRST_NS: u64 = 100_000_000;
    /// The longest wait.
    pub const LONGEST_NS: u64 = 2_000_000_000;

    /// Not waiting.
    #[must_use]
    pub fn new() -> Self {
        Self { wait_ns: Self::FIRST_NS, until_ns: 0 }
    }

    /// Waits from now on, and twice as long the next time.
    pub fn wait(&mut self, now_ns: u64) {
        self.until_ns = now_ns.saturating_add(self.wait_ns);
        self.wait_ns = (self.wait_ns * 2).min(Self::LONGEST_NS);
    }

    /// Whether the wait is over.
    #[must_use]
    pub fn is_over(&self, now_ns: u64) -> bool {
        now_ns >= self.until_ns
    }

    /// When the wait is over, monotonic.
    #[must_use]
    pub fn until_ns(&self) -> u64 {
        self.until_ns
    }

    /// All is well: the next wait is the shortest again.
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
    fn waits_double_up_to_two_seconds() {
        let mut backoff = Backoff::new();
        let mut waits = Vec::new();
        for _ in 0..7 {
            backoff.wait(0);
            waits.push(backoff.until_ns() / 1_000_000);
        }
        assert_eq!(waits, [100, 200, 400, 800, 1600, 2000, 2000]);
        backoff.reset();
        assert!(backoff.is_over(0));
    }
}
