//! The base's side of the bus: received frames, published state, and the reactions to bus errors.

use hal::Clock;

use super::{DifferentialBase, MS, Phase};
use crate::can::bus::{BusEvent, CanBus, ErrorState, SendProblem};
use crate::can::error::Trip;
use crate::can::frame::CanFrame;
use crate::can::messages::MessageError::{Checksum, Shape};
use crate::can::messages::{BaseCommand, BaseState, SafetyInput};

/// A transmit queue that stays full for this long is blocked.
const BLOCKED_NS: u64 = 50 * MS;
/// Frames of the safety board that may be lost between two others. A frame with an unchanged counter
/// is a repetition, and one after a larger gap is late or from a board that restarted: neither
/// proves that the board is alive.
const MOST_LOST: u8 = 5;
/// After working for this long, the bus counts as healthy and the back-off is reset.
const HEALTHY_NS: u64 = 1_000 * MS;

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
                self.bus_gone = true;
                self.lose_bus(Trip::BusGone, now_ns);
            }
            BusEvent::Back => {
                self.status.reopened += u64::from(std::mem::take(&mut self.bus_gone));
            }
            BusEvent::Restarted => self.error_state = ErrorState::Active,
            BusEvent::NoAcknowledge | BusEvent::Overflow | BusEvent::Noise => {
                self.counts.bus_errors += 1;
            }
        }
    }

    /// Reacts to a bus that failed: trips the base, drops the pending frames, sends nothing during
    /// a back-off, and sets the motors up again.
    pub(super) fn lose_bus(&mut self, trip: Trip, now_ns: u64) {
        self.trip(trip, now_ns);
        if !self.bus_gone {
            self.bus.drop_pending();
            if self.backoff.is_over(now_ns) {
                self.backoff.wait(now_ns);
            }
        }
        self.healthy_since_ns = self.backoff.until_ns().max(now_ns);
        self.motors.iter_mut().for_each(|motor| motor.restart());
    }

    pub(super) fn on_frame(&mut self, frame: &CanFrame, time_ns: u64) {
        for (motor, heard_ns) in self.motors.iter_mut().zip(&mut self.heard_ns) {
            if motor.receive(frame, time_ns) {
                *heard_ns = time_ns;
                return;
            }
        }
        match SafetyInput::decode(frame) {
            Ok(input) => self.on_safety_input(input, time_ns),
            Err(Checksum) => self.counts.corrupt += 1,
            Err(Shape) => self.counts.foreign += 1,
        }
    }

    fn on_safety_input(&mut self, input: SafetyInput, time_ns: u64) {
        // A press counts whatever its counter is, and however short it is.
        self.estop_seen |= input.estop;
        let last = self.safety.map(|(_, last)| last.counter);
        let step = last.map(|last| input.counter.wrapping_sub(last) & 0x0f);
        if step.is_none_or(|step| (1..=MOST_LOST + 1).contains(&step)) {
            self.safety = Some((time_ns, input));
        } else if step != Some(0)
            && let Some((_, last)) = &mut self.safety
        {
            // The board restarted or a frame is late. The next frame has to follow this one.
            *last = SafetyInput { estop: last.estop || input.estop, ..input };
        }
    }

    pub(super) fn send(&mut self, frame: &CanFrame, first_problem: &mut Option<SendProblem>) {
        if let Err(problem) = self.bus.send(frame) {
            self.counts.unsent += 1;
            first_problem.get_or_insert(problem);
        }
    }

    /// Publishes the command with every tick, and the state of the base with every tenth.
    pub(super) fn publish_state(&mut self, first_problem: &mut Option<SendProblem>) {
        let counter = (self.ticks % 16) as u8;
        let plan_age_ms = u16::try_from(self.plan_age_ns / MS).unwrap_or(u16::MAX);
        let command = BaseCommand {
            counter,
            armed: self.phase == Phase::Armed,
            stop: matches!(self.phase, Phase::Tripped(_)),
            plan_age_ms,
            twist: self.kinematics.twist(self.wheels_mps),
        };
        self.send(&command.encode(), first_problem);
        if self.ticks.is_multiple_of(10) {
            let (phase, trip) = match self.phase {
                Phase::Disarmed => (0, 0),
                Phase::Arming => (1, 0),
                Phase::Armed => (2, 0),
                Phase::Disarming => (3, 0),
                Phase::Tripped(trip) => (4, trip.number()),
            };
            let counter = (self.ticks / 10 % 16) as u8;
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
        self.ticks += 1;
    }

    /// Evaluates the first send error of a tick: a blocked or lost bus trips the base.
    pub(super) fn check_transmission(&mut self, first_problem: Option<SendProblem>, now_ns: u64) {
        match first_problem {
            None => {
                self.blocked_since_ns = None;
                if now_ns.saturating_sub(self.healthy_since_ns) > HEALTHY_NS {
                    self.backoff.reset();
                }
            }
            // The bus reports by an event when it is open again.
            Some(SendProblem::Down | SendProblem::Gone) => {
                self.trip(Trip::BusGone, now_ns);
                self.healthy_since_ns = now_ns;
            }
            Some(_) => {
                let since = *self.blocked_since_ns.get_or_insert(now_ns);
                if now_ns.saturating_sub(since) >= BLOCKED_NS {
                    self.lose_bus(Trip::TransmitBlocked, now_ns);
                }
            }
        }
    }
}
