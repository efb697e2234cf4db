//! What is watched per wheel while it is commanded: does it turn, and does it turn the right way?

/// A wheel is judged after this much commanded travel in one direction, metres. Less, and the lag of a motor that is just being
/// turned round would look like a wrong direction.
const JUDGED_AFTER_M: f64 = 0.03;
/// Travel against the command that is wrong, metres.
const WRONG_M: f64 = 0.01;
/// A wheel that is commanded at least this fast, m/s ...
const STALL_ABOVE_MPS: f64 = 0.02;
/// ... and reaches less than this share of it ...
const STALL_SHARE: f64 = 0.2;
/// ... for this long is stalled.
const STALL_NS: u64 = 300_000_000;

/// One wheel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct WheelGuard {
    commanded_m: f64,
    measured_m: f64,
    stalled_ns: u64,
}

impl WheelGuard {
    /// One turn of the loop: velocity commanded, m/s at the rim, and how long it held.
    pub(super) fn commanded(
        &mut self,
        velocity_mps: f64,
        velocity_measured_mps: f64,
        elapsed_ns: u64,
    ) {
        if velocity_mps * self.commanded_m < 0.0 || velocity_mps == 0.0 {
            (self.commanded_m, self.measured_m) = (0.0, 0.0);
        }
        self.commanded_m += velocity_mps * elapsed_ns as f64 * 1e-9;
        let stalls = velocity_mps.abs() >= STALL_ABOVE_MPS
            && velocity_measured_mps * velocity_mps.signum() < STALL_SHARE * velocity_mps.abs();
        self.stalled_ns = if stalls { self.stalled_ns.saturating_add(elapsed_ns) } else { 0 };
    }

    /// Travel measured at the rim, metres.
    pub(super) fn measured(&mut self, travel_m: f64) {
        self.measured_m += travel_m;
    }

    /// It turns against its command.
    pub(super) fn is_wrong(&self) -> bool {
        self.commanded_m.abs() >= JUDGED_AFTER_M
            && self.measured_m * self.commanded_m.signum() <= -WRONG_M
    }

    /// It is commanded and does not turn.
    pub(super) fn is_stalled(&self) -> bool {
        self.stalled_ns >= STALL_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN_NS: u64 = 10_000_000;

    #[test]
    fn a_wheel_that_turns_back_is_wrong_after_three_centimetres() {
        let mut guard = WheelGuard::default();
        let mut turns = 0;
        while !guard.is_wrong() {
            guard.commanded(0.1, -0.1, TURN_NS);
            guard.measured(-0.001);
            turns += 1;
        }
        assert_eq!(turns, 30);
    }

    #[test]
    fn a_wheel_that_lags_while_it_is_turned_round_is_not_wrong() {
        let mut guard = WheelGuard::default();
        let mut measured = 0.3;
        for turn in 0..200 {
            // From 0.3 m/s forwards to 0.3 m/s backwards at 1 m/s², followed with a time constant of 80 ms.
            let commanded = (0.3 - f64::from(turn) * 0.01).max(-0.3);
            measured += (commanded - measured) * 0.01 / 0.08;
            guard.commanded(commanded, measured, TURN_NS);
            guard.measured(measured * 0.01);
            assert!(!guard.is_wrong(), "turn {turn}");
        }
    }

    #[test]
    fn a_blocked_wheel_is_stalled_and_one_at_a_stand_is_not() {
        let mut guard = WheelGuard::default();
        (0..30).for_each(|_| guard.commanded(0.2, 0.0, TURN_NS));
        assert!(guard.is_stalled());
        guard.commanded(0.0, 0.0, TURN_NS);
        assert!(!guard.is_stalled());
    }
}
