//! The supply and the temperature that a motor controller reports.

use hal::PowerReport;

/// A value that is older than this is not reported any more: controllers send it at 1 Hz or faster.
const STALE_NS: u64 = 3_000_000_000;

/// A value and the time when it arrived.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Reading {
    value: f64,
    /// 0 before the first one.
    time_ns: u64,
}

impl Reading {
    fn fresh(self, now_ns: u64) -> Option<f64> {
        let is_fresh = self.time_ns > 0 && now_ns.saturating_sub(self.time_ns) <= STALE_NS;
        is_fresh.then_some(self.value)
    }
}

/// What one controller reported last. A value that is not finite is not taken.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PowerReadings {
    voltage_v: Reading,
    current_a: Reading,
    temperature_c: Reading,
}

impl PowerReadings {
    /// Supply voltage, V.
    pub fn voltage(&mut self, value: f64, time_ns: u64) {
        take(&mut self.voltage_v, value, time_ns);
    }

    /// Current from the supply, A.
    pub fn current(&mut self, value: f64, time_ns: u64) {
        take(&mut self.current_a, value, time_ns);
    }

    /// Temperatures of inverter and motor, degrees Celsius. The higher one counts; a sensor that is
    /// not connected reports NaN, or less than -40.
    pub fn temperatures(&mut self, values: [f64; 2], time_ns: u64) {
        let connected = values.into_iter().filter(|value| *value > -40.0);
        let hottest = connected.fold(f64::NAN, f64::max);
        take(&mut self.temperature_c, hottest, time_ns);
    }

    /// The readings that are new enough.
    #[must_use]
    pub fn report(&self, now_ns: u64) -> PowerReport {
        PowerReport {
            voltage_v: self.voltage_v.fresh(now_ns),
            current_a: self.current_a.fresh(now_ns),
            temperature_c: self.temperature_c.fresh(now_ns),
        }
    }
}

fn take(reading: &mut Reading, value: f64, time_ns: u64) {
    if value.is_finite() {
        *reading = Reading { value, time_ns };
    }
}

/// The report of a base with two controllers: the lowest voltage, the sum of the currents if both
/// report one, and the highest temperature.
#[must_use]
pub fn combined([left, right]: [PowerReport; 2]) -> PowerReport {
    let voltages = [left.voltage_v, right.voltage_v].into_iter().flatten();
    let temperatures = [left.temperature_c, right.temperature_c].into_iter().flatten();
    PowerReport {
        voltage_v: voltages.reduce(f64::min),
        current_a: left.current_a.zip(right.current_a).map(|(left, right)| left + right),
        temperature_c: temperatures.reduce(f64::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_that_is_old_or_not_finite_is_not_reported() {
        let mut readings = PowerReadings::default();
        assert_eq!(readings.report(5), PowerReport::default());
        readings.voltage(24.0, 10);
        readings.voltage(f64::NAN, 20);
        assert_eq!(readings.report(STALE_NS + 10).voltage_v, Some(24.0));
        assert_eq!(readings.report(STALE_NS + 11).voltage_v, None);
    }

    #[test]
    fn the_hotter_of_motor_and_inverter_counts_and_a_sensor_that_is_not_connected_does_not() {
        let mut readings = PowerReadings::default();
        readings.temperatures([41.0, 62.5], 1);
        assert_eq!(readings.report(1).temperature_c, Some(62.5));
        readings.temperatures([41.0, f64::NAN], 2);
        assert_eq!(readings.report(2).temperature_c, Some(41.0));
        readings.temperatures([-273.1, f64::NAN], 3);
        assert_eq!(readings.report(3).temperature_c, Some(41.0), "nothing new was measured");
    }

    #[test]
    fn a_base_reports_its_weaker_and_its_hotter_side() {
        let both = combined([side(23.5, Some(1.0), 40.0), side(23.8, Some(2.5), 35.0)]);
        assert_eq!(both, side(23.5, Some(3.5), 40.0));
        let one = combined([side(23.5, None, 40.0), PowerReport::default()]);
        assert_eq!(one, side(23.5, None, 40.0));
    }

    fn side(volts: f64, amperes: Option<f64>, degrees: f64) -> PowerReport {
        PowerReport { voltage_v: Some(volts), current_a: amperes, temperature_c: Some(degrees) }
    }
}
