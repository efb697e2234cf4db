//! Supervision of a commanded wheel: it must rotate, and in the commanded direction.

/// The direction is checked after this much commanded travel in one direction, metres. With less,
/// the lag of a motor that is being reversed would look like a wrong direction.
const CHECKED_AFTER_M: f64 = 0.03;
/// This much travel against the command is a wrong direction, metres.
const WRONG_M: f64 = 0.01;
/// Stall detection applies to wheels that are commanded to rotate at least this fast, m/s.
const STALL_ABOVE_MPS: f64 = 0.02;
/// A wheel that reaches less than this share of its command may be stalled.
const STALL_SHARE: f64 = 0.2;
/// A wheel below that share for this long is stalled.
const STALL_NS: u64 = 300_000_000;

/// The supervision of one wheel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct WheelGuard {
    commanded_m: f64,
    measured_m: f64,
    stalled_ns: u64,
}

impl WheelGuard {
    /// Records one control tick: the commanded and the measured velocity at the rim, and how long
    /// they held.
    pub(super) fn commanded(
        &mut self,
        velocity_mps: f64,
        velocity_measured_mps: f64,
        elapsed_ns: u64,
    ) {
        if velocity_mps * self.commanded_m < 0.0 || velocity_mps == 0.0 {
            self.commanded_m = 0.0;
            self.measured_m = 0.0;
        }
        self.commanded_m += velocity_mps * elapsed_ns as f64 * 1e-9;
        let stalls = velocity_mps.abs() >= STALL_ABOVE_MPS
            && velocity_measured_mps * velocity_mps.signum() < STALL_SHARE * velocity_mps.abs();
        self.stalled_ns = if stalls { self.stalled_ns.saturating_add(elapsed_ns) } else { 0 };
    }

    /// Records travel measured at the rim, metres.
    pub(super) fn measured(&mut self, travel_m: f64) {
        self.measured_m += travel_m;
    }

    /// Whether the wheel rotates against its command.
    pub(super) fn is_wrong_direction(&self) -> bool {
        self.commanded_m.abs() >= CHECKED_AFTER_M
            && self.measured_m * self.commanded_m.signum() <= -WRONG_M
    }

    /// Whether the wheel is commanded and does not rotate.
    pub(super) fn is_stalled(&self) -> bool {
        self.stalled_ns >= STALL_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_NS: u64 = 10_000_000;

    #[test]
    fn a_wheel_that_rotates_backwards_is_detected_after_three_centimetres() {
        let mut guard = WheelGuard::default();
        let mut ticks = 0;
        while !guard.is_wrong_direction() {
            guard.commanded(0.1, -0.1, TICK_NS);
            guard.measured(-0.001);
            ticks += 1;
        }
        assert_eq!(ticks, 30);
    }

    #[test]
    fn a_wheel_that_lags_while_it_is_reversed_has_no_wrong_direction() {
        let mut guard = WheelGuard::default();
        let mut measured = 0.3;
        for tick in 0..200 {
            // The command goes from 0.3 m/s forwards to 0.3 m/s backwards at 1 m/s², and the wheel
            // follows it with a time constant of 80 ms.
            let commanded = (0.3 - f64::from(tick) * 0.01).max(-0.3);
            measured += (commanded - measured) * 0.01 / 0.08;
            guard.commanded(commanded, measured, TICK_NS);
            guard.measured(measured * 0.01);
            assert!(!guard.is_wrong_direction(), "tick {tick}");
        }
    }

    #[test]
    fn a_blocked_wheel_is_stalled_and_a_wheel_commanded_to_stand_is_not() {
        let mut guard = WheelGuard::default();
        (0..30).for_each(|_| guard.commanded(0.2, 0.0, TICK_NS));
        assert!(guard.is_stalled());
        guard.commanded(0.0, 0.0, TICK_NS);
        assert!(!guard.is_stalled());
    }
}
