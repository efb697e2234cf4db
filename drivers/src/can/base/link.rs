//! The base and its bus: what comes, what goes, and what is done when it is ill.

use hal::Clock;

use super::{DifferentialBase, MS, Phase};
use crate::can::bus::{BusEvent, CanBus, ErrorState, SendProblem};
use crate::can::error::Trip;
use crate::can::frame::CanFrame;
use crate::can::messages::MessageError::{Checksum, Shape};
use crate::can::messages::{BaseCommand, BaseState, SafetyInput};

/// A queue that stays full for so long is stuck.
const BLOCKED_NS: u64 = 50 * MS;
/// A bus that has worked for so long is well again.
const WELL_NS: u64 = 1_000 * MS;

impl<B: CanBus, C: Clock> DifferentialBase<B, C> {
    pub(super) fn on_event(&mut self, event: &BusEvent, time_ns: u64, now_ns: u64) {
        match event {
            BusEvent::Frame(frame) => self.on_frame(frame, time_ns),
            BusEvent::Errors { state, transmit, receive } => {
                self.error_state = *state;
                self.error_counters = (*transmit, *receive);
                self.counts.bus_errors += 1;
            }
            BusEvent::BusOff => {
                self.counts.bus_off += 1;
                self.lose_bus(Trip::BusOff, now_ns);
            }
            BusEvent::Gone => {
                self.gone = true;
                self.lose_bus(Trip::BusGone, now_ns);
            }
            BusEvent::Back => {
                self.status.reopened += u64::from(std::mem::take(&mut self.gone));
            }
            BusEvent::Restarted => self.error_state = ErrorState::Active,
            BusEvent::NoAcknowledge | BusEvent::Overflow | BusEvent::Noise => {
                self.counts.bus_errors += 1;
            }
        }
    }

    /// The bus cannot be trusted: zero, nothing of the past may still be sent, silence for a while, and the motors are set up
    /// anew.
    pub(super) fn lose_bus(&mut self, trip: Trip, now_ns: u64) {
        self.trip(trip, now_ns);
        if !self.gone {
            self.bus.drop_pending();
            if self.backoff.is_over(now_ns) {
                self.backoff.wait(now_ns);
            }
        }
        self.well_since_ns = self.backoff.until_ns().max(now_ns);
        self.motors.iter_mut().for_each(|motor| motor.restart());
    }

    pub(super) fn on_frame(&mut self, frame: &CanFrame, time_ns: u64) {
        if self.motors.iter_mut().any(|motor| motor.receive(frame, time_ns)) {
            return;
        }
        match SafetyInput::decode(frame) {
            Ok(input) => {
                // A counter that stands still is a frame that is repeated, not a board that lives.
                if self.safety.is_none_or(|(_, last)| last.counter != input.counter) {
                    self.safety = Some((time_ns, input));
                }
            }
            Err(Checksum) => self.counts.corrupt += 1,
            Err(Shape) => self.counts.foreign += 1,
        }
    }

    pub(super) fn send(&mut self, frame: &CanFrame, first_problem: &mut Option<SendProblem>) {
        if let Err(problem) = self.bus.send(frame) {
            self.counts.unsent += 1;
            first_problem.get_or_insert(problem);
        }
    }

    pub(super) fn announce(&mut self, first_problem: &mut Option<SendProblem>) {
        let counter = (self.turns % 16) as u8;
        let plan_age_ms = u16::try_from(self.plan_age_ns / MS).unwrap_or(u16::MAX);
        let (armed, stop) = (self.phase == Phase::Armed, matches!(self.phase, Phase::Tripped(_)));
        let command = BaseCommand {
            counter,
            armed,
            stop,
            plan_age_ms,
            twist: self.kinematics.twist(self.wheels_mps),
        };
        self.send(&command.encode(), first_problem);
        if self.turns.is_multiple_of(10) {
            let (phase, trip) = match self.phase {
                Phase::Disarmed => (0, 0),
                Phase::Arming => (1, 0),
                Phase::Armed => (2, 0),
                Phase::Disarming => (3, 0),
                Phase::Tripped(trip) => (4, trip.number()),
            };
            let counter = (self.turns / 10 % 16) as u8;
            let state = BaseState {
                counter,
                phase,
                trip,
                estop: self.estop,
                contact: self.contact(),
                twist: self.twist,
            };
            self.send(&state.encode(), first_problem);
        }
        self.turns += 1;
    }

    /// What the turn's sending says about the bus.
    pub(super) fn judge(&mut self, first_problem: Option<SendProblem>, now_ns: u64) {
        match first_problem {
            None => {
                self.full_since_ns = None;
                if now_ns.saturating_sub(self.well_since_ns) > WELL_NS {
                    self.backoff.reset();
                }
            }
            // The bus says by itself when it is back.
            Some(SendProblem::Down | SendProblem::Gone) => {
                self.trip(Trip::BusGone, now_ns);
                self.well_since_ns = now_ns;
            }
            Some(_) => {
                let since = *self.full_since_ns.get_or_insert(now_ns);
                if now_ns.saturating_sub(since) >= BLOCKED_NS {
                    self.lose_bus(Trip::TransmitBlocked, now_ns);
                }
            }
        }
    }
}
