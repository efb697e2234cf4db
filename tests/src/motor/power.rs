//! The supply of a simulated controller: power cuts, and the time that it takes to start.

use drivers::can::CanFrame;

use super::node::{MotorNode, NodeFaults, Watchdog, elapsed_s};
use super::wheel::{Drive, Wheel};

/// A controller with a supply that may be cut. Without power, and while it starts, it receives and
/// sends nothing, and its wheel coasts.
pub struct Supplied<N> {
    controller: N,
    last_ns: u64,
    is_on: bool,
    boots_until_ns: u64,
}

impl<N: MotorNode> Supplied<N> {
    /// A controller that has been powered for a while.
    pub fn new(controller: N) -> Self {
        Self { controller, last_ns: 0, is_on: true, boots_until_ns: 0 }
    }

    /// Whether the controller runs at `now_ns`. It forgets everything when it starts.
    fn runs(&mut self, now_ns: u64) -> bool {
        let NodeFaults { unpowered, boot_ns, reboot, .. } = *self.controller.faults();
        if unpowered || reboot && self.is_on && boot_ns > 0 {
            self.is_on = false;
            self.boots_until_ns = now_ns + boot_ns;
        }
        if !self.is_on && !unpowered && now_ns >= self.boots_until_ns {
            self.is_on = true;
            self.controller.faults().reboot = true;
        }
        if self.is_on && self.controller.faults().reboot {
            let wheel = self.controller.wheel_mut();
            wheel.encoder_zero_rad = wheel.position_rad();
        }
        self.is_on
    }
}

impl<N: MotorNode> MotorNode for Supplied<N> {
    fn receive(&mut self, frame: &CanFrame, now_ns: u64) {
        if self.is_on {
            self.controller.receive(frame, now_ns);
        }
    }

    fn step(&mut self, now_ns: u64, out: &mut Vec<CanFrame>) {
        let seconds = elapsed_s(&mut self.last_ns, now_ns);
        if self.runs(now_ns) {
            self.controller.step(now_ns, out);
        } else {
            let wheel = self.controller.wheel_mut();
            wheel.set_drive(Drive::Coast);
            wheel.step(seconds);
        }
    }

    fn wheel(&self) -> &Wheel {
        self.controller.wheel()
    }

    fn wheel_mut(&mut self) -> &mut Wheel {
        self.controller.wheel_mut()
    }

    fn faults(&mut self) -> &mut NodeFaults {
        self.controller.faults()
    }

    fn watchdog(&self) -> &Watchdog {
        self.controller.watchdog()
    }

    fn is_powered(&self) -> bool {
        self.is_on && self.controller.is_powered()
    }
}
