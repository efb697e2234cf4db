//! What all simulated motor controllers have in common.

use drivers::can::CanFrame;

use super::wheel::Wheel;

/// A motor controller without a bus: frames and the time go in, frames come out.
pub trait MotorNode: Send {
    /// A frame on the bus, anybody's.
    fn receive(&mut self, frame: &CanFrame, now_ns: u64);

    /// Time passes up to `now_ns`; adds what the controller sends.
    fn step(&mut self, now_ns: u64, out: &mut Vec<CanFrame>);

    /// The wheel it drives.
    fn wheel(&self) -> &Wheel;

    /// The wheel, to block it or to turn its encoder round.
    fn wheel_mut(&mut self) -> &mut Wheel;

    /// What can be wrong with it.
    fn faults(&mut self) -> &mut NodeFaults;

    /// What its watchdog did.
    fn watchdog(&self) -> &Watchdog;

    /// Whether it powers its motor.
    fn is_powered(&self) -> bool;
}

/// What can be wrong with a controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NodeFaults {
    /// Sends nothing, but listens.
    pub silent: bool,
    /// Has a hardware fault, until cleared.
    pub broken: bool,
    /// Takes the watchdog setting, and keeps another one.
    pub forgets_watchdog: bool,
    /// Loses power for a moment at its next step.
    pub reboot: bool,
}

/// A controller's own watchdog, by its own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Watchdog {
    /// How long it waits; `None` while it is off.
    pub limit_ns: Option<u64>,
    /// When it was fed last.
    pub fed_ns: u64,
    /// How often it expired.
    pub expired: u32,
    /// When it expired last.
    pub expired_ns: u64,
}

impl Watchdog {
    /// A command came.
    pub fn feed(&mut self, now_ns: u64) {
        self.fed_ns = now_ns;
    }

    /// Whether it has just expired; before the first command there is nothing to miss. Fed again only by the next command.
    pub fn expires(&mut self, now_ns: u64) -> bool {
        let silent_ns = now_ns.saturating_sub(self.fed_ns);
        let expires = self.limit_ns.is_some_and(|limit_ns| silent_ns > limit_ns);
        if expires && self.fed_ns > 0 && self.expired_ns <= self.fed_ns {
            self.expired += 1;
            self.expired_ns = now_ns;
            return true;
        }
        false
    }
}

/// Something that is sent in a fixed rhythm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Every {
    period_ns: u64,
    next_ns: u64,
}

impl Every {
    pub(super) fn milliseconds(period_ms: u64) -> Self {
        Self { period_ns: period_ms * 1_000_000, next_ns: 0 }
    }

    /// Whether it is time. Beats that were missed are left out.
    pub(super) fn is_due(&mut self, now_ns: u64) -> bool {
        let due = now_ns >= self.next_ns;
        if due {
            self.next_ns = (self.next_ns + self.period_ns)
                .max(now_ns - now_ns % self.period_ns.max(1) + self.period_ns);
        }
        due
    }
}

/// Seconds since the last step, at most a second of them.
pub(super) fn elapsed_s(last_ns: &mut u64, now_ns: u64) -> f64 {
    let elapsed_ns = now_ns.saturating_sub(std::mem::replace(last_ns, now_ns));
    elapsed_ns.min(1_000_000_000) as f64 * 1e-9
}

/// A frame with an 11-bit id. The simulators make only sound ones.
pub(super) fn standard(id: u16, payload: &[u8]) -> CanFrame {
    let mut data = [0; 8];
    data.iter_mut().zip(payload).for_each(|(byte, value)| *byte = *value);
    CanFrame::standard_short(id, data, payload.len())
}

/// A frame with a 29-bit id.
pub(super) fn extended(id: u32, payload: &[u8]) -> CanFrame {
    let mut data = [0; 8];
    data.iter_mut().zip(payload).for_each(|(byte, value)| *byte = *value);
    CanFrame::extended_short(id, data, payload.len())
}
