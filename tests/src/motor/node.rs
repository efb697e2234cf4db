//! The interface and the faults that all simulated motor controllers share.

use drivers::can::CanFrame;

use super::wheel::Wheel;

/// A motor controller without a bus: frames and times go in, frames come out.
pub trait MotorNode: Send {
    /// Processes a frame from the bus, for any node.
    fn receive(&mut self, frame: &CanFrame, now_ns: u64);

    /// Advances to `now_ns` and appends the frames that the controller sends.
    fn step(&mut self, now_ns: u64, out: &mut Vec<CanFrame>);

    fn wheel(&self) -> &Wheel;

    /// The wheel, for blocking it or reversing its encoder.
    fn wheel_mut(&mut self) -> &mut Wheel;

    /// The controller's faults, for injecting them.
    fn faults(&mut self) -> &mut NodeFaults;

    fn watchdog(&self) -> &Watchdog;

    /// Whether the controller powers its motor.
    fn is_powered(&self) -> bool;
}

/// Faults of a controller.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NodeFaults {
    /// Sends nothing, but still receives.
    pub silent: bool,
    /// Has a hardware fault until this is cleared.
    pub broken: bool,
    /// Acknowledges the watchdog setting but does not store it.
    pub forgets_watchdog: bool,
    /// Loses power for a moment at its next step.
    pub reboot: bool,
    /// Has no power until this is cleared: it receives and sends nothing, and the wheel coasts.
    pub unpowered: bool,
    /// Time from power to the first frame.
    pub boot_ns: u64,
    /// What it measures about its supply and its temperatures.
    pub supply: Supply,
}

/// A controller's watchdog, by the controller's own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Watchdog {
    /// Time-out; `None` while the watchdog is off.
    pub limit_ns: Option<u64>,
    /// Time of the last command.
    pub fed_ns: u64,
    /// Number of times that it has expired.
    pub expired: u32,
    /// Time when it last expired.
    pub expired_ns: u64,
}

impl Watchdog {
    /// Records a command, which restarts the time-out.
    pub fn feed(&mut self, now_ns: u64) {
        self.fed_ns = now_ns;
    }

    /// Whether the watchdog has just expired. It does not run before the first command, and
    /// restarts only with the next command.
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

/// The supply and the temperatures that a simulated controller measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supply {
    pub voltage_v: f64,
    pub current_a: f64,
    pub inverter_c: f64,
    pub motor_c: f64,
}

impl Default for Supply {
    /// A charged battery of 24 V and a robot that has driven for a while.
    fn default() -> Self {
        Self { voltage_v: 24.0, current_a: 1.0, inverter_c: 30.0, motor_c: 27.0 }
    }
}

/// Timer of a periodic message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Periodic {
    period_ns: u64,
    next_ns: u64,
}

impl Periodic {
    pub(super) fn milliseconds(period_ms: u64) -> Self {
        Self { period_ns: period_ms * 1_000_000, next_ns: 0 }
    }

    /// Whether the message is due. Missed periods are skipped.
    pub(super) fn is_due(&mut self, now_ns: u64) -> bool {
        let due = now_ns >= self.next_ns;
        if due {
            self.next_ns = (self.next_ns + self.period_ns)
                .max(now_ns - now_ns % self.period_ns.max(1) + self.period_ns);
        }
        due
    }
}

/// Seconds since the last step, at most one.
pub(super) fn elapsed_s(last_ns: &mut u64, now_ns: u64) -> f64 {
    let elapsed_ns = now_ns.saturating_sub(std::mem::replace(last_ns, now_ns));
    elapsed_ns.min(1_000_000_000) as f64 * 1e-9
}

/// A frame with an 11-bit id. The simulators create only valid ones.
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
