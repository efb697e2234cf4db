//! The operator's orders to the safety loop, and the loop's answer: atomic numbers, without lock and without allocation. The
//! safety thread of a robot and the virtual time of a simulation have the same panel.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use runtime::event::FaultReason;
use runtime::recording::fault_reason;
use runtime::safety::{Orders, Request, STOPS, SafetyState};

/// Steps between clearing a fault and arming: the state machine leaves the fault in the first one.
const STEPS_BEFORE_ARMING: u32 = 3;
/// Number of the first fault in [`Shared::plane`]; the rows of [`STOPS`] follow.
const FIRST_FAULT: u8 = 16;

/// The operator's orders to the safety loop, and whether the robot may move. All threads may use it.
#[derive(Debug, Clone, Default)]
pub struct ControlPanel {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    arms: AtomicBool,
    disarms: AtomicBool,
    stops: AtomicBool,
    /// [`Plane`] as a number.
    plane: AtomicU8,
}

/// The state of the safety plane without its progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Plane {
    #[default]
    Disarmed,
    Clear,
    Slow,
    Tripped,
    BackingOff,
    Escaping,
    Fault(FaultReason),
}

impl Plane {
    /// The state's name, as [`SafetyState::name`].
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Disarmed => "disarmed",
            Self::Clear => "clear",
            Self::Slow => "slow",
            Self::Tripped => "tripped",
            Self::BackingOff => "backing off",
            Self::Escaping => "escaping",
            Self::Fault(_) => "fault",
        }
    }

    /// The name; for a fault, its reason as well.
    #[must_use]
    pub fn words(self) -> String {
        match self {
            Self::Fault(why) => format!("fault: {}", fault_reason(why)),
            state => state.name().to_owned(),
        }
    }
}

/// Whether the robot may move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// The robot has not been armed yet, or it was disarmed.
    Disarmed,
    /// The robot drives, or stands for a reason that passes.
    Armed,
    /// The robot stands until a person has inspected it.
    NeedsPerson(FaultReason),
}

impl ControlPanel {
    /// Clears a fault and arms the robot, after a person has inspected it.
    pub fn arm(&self) {
        self.shared.arms.store(true, Ordering::Release);
    }

    /// Stops the robot and releases the motors.
    pub fn disarm(&self) {
        self.shared.disarms.store(true, Ordering::Release);
    }

    /// Triggers an emergency stop.
    pub fn stop(&self) {
        self.shared.stops.store(true, Ordering::Release);
    }

    /// The state of the safety plane after its last step.
    #[must_use]
    pub fn plane(&self) -> Plane {
        match self.shared.plane.load(Ordering::Acquire) {
            1 => Plane::Clear,
            2 => Plane::Slow,
            3 => Plane::Tripped,
            4 => Plane::BackingOff,
            5 => Plane::Escaping,
            number => number
                .checked_sub(FIRST_FAULT)
                .and_then(|row| STOPS.get(usize::from(row)))
                .map_or(Plane::Disarmed, |stop| Plane::Fault(stop.why)),
        }
    }

    /// Whether the robot may move, according to the last step.
    #[must_use]
    pub fn motion(&self) -> Motion {
        match self.plane() {
            Plane::Disarmed => Motion::Disarmed,
            Plane::Fault(why) if why.needs_person() => Motion::NeedsPerson(why),
            _ => Motion::Armed,
        }
    }

    fn publish(&self, state: SafetyState) {
        let number = match state {
            SafetyState::Disarmed => 0,
            SafetyState::Clear => 1,
            SafetyState::Slow => 2,
            SafetyState::Tripped { .. } => 3,
            SafetyState::BackingOff(_) => 4,
            SafetyState::Escaping(_) => 5,
            SafetyState::Fault(why) => {
                FIRST_FAULT + STOPS.iter().position(|stop| stop.why == why).unwrap_or(0) as u8
            }
        };
        self.shared.plane.store(number, Ordering::Release);
    }
}

/// The safety loop's end of a panel.
#[derive(Debug)]
pub struct PanelReader {
    panel: ControlPanel,
    /// Steps until a request to arm is passed on.
    arms_in: Option<u32>,
}

impl PanelReader {
    /// The end of `panel` that takes its orders. There is one for each panel.
    #[must_use]
    pub fn new(panel: ControlPanel) -> Self {
        Self { panel, arms_in: None }
    }

    /// The operator's orders for this step. What stops the robot takes precedence over a request to arm, whichever came first.
    pub fn orders(&mut self) -> Orders {
        let shared = &self.panel.shared;
        let arms = shared.arms.swap(false, Ordering::AcqRel);
        let disarms = shared.disarms.swap(false, Ordering::AcqRel);
        let emergency_stop = shared.stops.swap(false, Ordering::AcqRel);
        let request = if disarms || emergency_stop {
            self.arms_in = None;
            disarms.then_some(Request::Disarm)
        } else if arms {
            self.arms_in = Some(STEPS_BEFORE_ARMING);
            Some(Request::ClearFault)
        } else {
            self.arms_in = self.arms_in.and_then(|steps| steps.checked_sub(1));
            (self.arms_in == Some(0)).then_some(Request::Arm)
        };
        Orders { request, emergency_stop, ..Orders::default() }
    }

    /// Shows the state to all owners of the panel.
    pub fn publish(&self, state: SafetyState) {
        self.panel.publish(state);
    }

    /// The other end.
    #[must_use]
    pub fn panel(&self) -> &ControlPanel {
        &self.panel
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_is_shown_as_it_is() {
        let panel = ControlPanel::default();
        assert_eq!((panel.plane(), panel.motion()), (Plane::Disarmed, Motion::Disarmed));
        for stop in STOPS {
            panel.publish(SafetyState::Fault(stop.why));
            assert_eq!(panel.plane(), Plane::Fault(stop.why));
            let stands = panel.motion() == Motion::NeedsPerson(stop.why);
            assert_eq!(stands, stop.why.needs_person());
        }
        panel.publish(SafetyState::Slow);
        assert_eq!((panel.plane(), panel.motion()), (Plane::Slow, Motion::Armed));
    }

    #[test]
    fn an_order_is_given_in_one_step_and_a_stop_goes_before_arming() {
        let panel = ControlPanel::default();
        let mut reader = PanelReader::new(panel.clone());
        panel.arm();
        panel.stop();
        let orders = reader.orders();
        assert!(orders.emergency_stop && orders.request.is_none());
        assert!(!reader.orders().emergency_stop);
        panel.arm();
        let requests: Vec<_> = (0..5).map(|_| reader.orders().request).collect();
        let expected = [Some(Request::ClearFault), None, None, Some(Request::Arm), None];
        assert_eq!(requests, expected);
    }

    #[test]
    fn a_stop_ends_a_request_to_arm_that_is_on_its_way() {
        let panel = ControlPanel::default();
        let mut reader = PanelReader::new(panel.clone());
        panel.arm();
        reader.orders();
        panel.disarm();
        assert_eq!(reader.orders().request, Some(Request::Disarm));
        assert!((0..5).all(|_| reader.orders().request.is_none()));
    }
}
