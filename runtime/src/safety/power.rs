//! Low battery and hot motors: when the robot stops, and when it drives slower.

use hal::{PowerReport, Twist2};

use super::SafetyConfig;

/// A battery is low when its voltage stays below the limit for this long: motors that accelerate
/// pull it down for less.
const LOW_NS: u64 = 5_000_000_000;
/// From `hot_c` on the speed falls linearly, to this share at [`HOTTEST_C`] more.
const LEAST_SPEED: f64 = 0.33;
const HOTTEST_C: f64 = 15.0;

/// What the reports of the base mean.
#[derive(Debug, Clone, Copy)]
pub(super) struct PowerWatch {
    low_battery_v: f64,
    hot_c: f64,
    low_since_ns: Option<u64>,
}

impl PowerWatch {
    pub fn new(config: &SafetyConfig) -> Self {
        let SafetyConfig { low_battery_v, hot_c, .. } = *config;
        Self { low_battery_v, hot_c, low_since_ns: None }
    }

    /// Whether the battery is low. A base that does not report its voltage has no low battery.
    pub fn is_low(&mut self, now_ns: u64, power: &PowerReport) -> bool {
        let is_below = power.voltage_v.is_some_and(|voltage_v| voltage_v < self.low_battery_v);
        if !is_below {
            self.low_since_ns = None;
            return false;
        }
        let since_ns = *self.low_since_ns.get_or_insert(now_ns);
        now_ns.saturating_sub(since_ns) >= LOW_NS
    }

    /// A command on the same path, slower if the motors are hot.
    pub fn slowed(&self, twist: Twist2, power: &PowerReport) -> Twist2 {
        let share = self.speed_share(power);
        Twist2 { linear_mps: share * twist.linear_mps, angular_radps: share * twist.angular_radps }
    }

    fn speed_share(&self, power: &PowerReport) -> f64 {
        let Some(temperature_c) = power.temperature_c.filter(|_| self.hot_c > 0.0) else {
            return 1.0;
        };
        let over = (temperature_c - self.hot_c) / HOTTEST_C;
        1.0 - (1.0 - LEAST_SPEED) * over.clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    fn volts(voltage_v: f64) -> PowerReport {
        PowerReport { voltage_v: Some(voltage_v), ..PowerReport::default() }
    }

    fn degrees(temperature_c: f64) -> PowerReport {
        PowerReport { temperature_c: Some(temperature_c), ..PowerReport::default() }
    }

    fn watch() -> PowerWatch {
        let config = SafetyConfig { low_battery_v: 21.0, hot_c: 80.0, ..SafetyConfig::default() };
        PowerWatch::new(&config)
    }

    #[test]
    fn a_battery_is_low_when_it_stays_below_the_limit_and_not_when_motors_pull_it_down() {
        let mut watch = watch();
        for second in 0..4 {
            assert!(!watch.is_low(second * S, &volts(20.0)));
        }
        assert!(!watch.is_low(4 * S, &volts(23.0)));
        for second in 5..10 {
            assert!(!watch.is_low(second * S, &volts(20.9)), "{second}");
        }
        assert!(watch.is_low(10 * S, &volts(20.9)));
    }

    #[test]
    fn a_voltage_that_is_not_reported_or_has_no_limit_stops_nothing() {
        let mut off = PowerWatch::new(&SafetyConfig::default());
        let mut on = watch();
        for second in 0..20 {
            assert!(!off.is_low(second * S, &volts(1.0)));
            assert!(!on.is_low(second * S, &PowerReport::default()));
        }
    }

    #[test]
    fn hot_motors_drive_the_same_path_slower_and_cool_ones_at_full_speed() {
        let twist = Twist2 { linear_mps: 0.3, angular_radps: -0.6 };
        let watch = watch();
        assert_eq!(watch.slowed(twist, &degrees(79.9)), twist);
        assert_eq!(watch.slowed(twist, &PowerReport::default()), twist);
        let warm = watch.slowed(twist, &degrees(87.5));
        assert!((warm.linear_mps - 0.3 * 0.665).abs() < 1e-9, "{warm:?}");
        assert!((warm.angular_radps / warm.linear_mps + 2.0).abs() < 1e-9);
        let hot = watch.slowed(twist, &degrees(140.0));
        assert!((hot.linear_mps - 0.3 * LEAST_SPEED).abs() < 1e-9, "{hot:?}");
    }

    #[test]
    fn without_a_limit_no_temperature_slows_the_robot() {
        let config = SafetyConfig { hot_c: 0.0, ..SafetyConfig::default() };
        let twist = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
        assert_eq!(PowerWatch::new(&config).slowed(twist, &degrees(140.0)), twist);
    }
}
