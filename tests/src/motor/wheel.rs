//! A wheel with its motor, with a first-order response.

/// Time constant of a wheel whose controller drives or brakes it, s: a typical velocity loop.
pub const LAG_S: f64 = 0.03;
/// Time constant of a wheel that its controller has released, s. An estimate, not a measurement: rolling resistance of a rubber tyre
/// on carpet or wood (0.01 to 0.02 of the weight) and the friction of a hub motor with its cogging (0.1 to 0.2 Nm at a radius of 8 cm,
/// for a robot of 10 kg) decelerate it by 0.35 to 0.7 m/s2. From 0.3 m/s it then rolls 6 to 13 cm. A wheel that loses its speed with
/// this time constant rolls 15 cm. A gear with a high ratio stops earlier; a heavy robot on smooth wheels rolls further.
pub const COAST_S: f64 = 0.5;

/// A wheel that is slower than this stands, rad/s: 0.5 mm/s at a radius of 5 cm.
pub const STANDING_RADPS: f64 = 0.01;

/// How the controller drives the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// The motor follows this velocity, rad/s.
    Velocity(f64),
    /// The motor is short-circuited or held at zero velocity.
    Brake,
    /// The motor is released; only friction acts.
    Coast,
}

/// A wheel without reduction gear.
#[derive(Debug, Clone, PartialEq)]
pub struct Wheel {
    drive: Drive,
    velocity_radps: f64,
    position_rad: f64,
    /// Time constant while driven and braked, s.
    pub lag_s: f64,
    /// Time constant of coasting, s.
    pub coast_s: f64,
    /// The wheel cannot rotate because the robot touches an obstacle.
    pub blocked: bool,
    /// The encoder counts in the opposite direction.
    pub encoder_reversed: bool,
    /// Position at which the encoder counts zero: that of the controller's last start.
    pub encoder_zero_rad: f64,
}

impl Default for Wheel {
    /// A wheel of a home robot with hub motors.
    fn default() -> Self {
        Self {
            drive: Drive::Coast,
            velocity_radps: 0.0,
            position_rad: 0.0,
            lag_s: LAG_S,
            coast_s: COAST_S,
            blocked: false,
            encoder_reversed: false,
            encoder_zero_rad: 0.0,
        }
    }
}

impl Wheel {
    pub fn set_drive(&mut self, drive: Drive) {
        self.drive = drive;
    }

    #[must_use]
    pub fn drive(&self) -> Drive {
        self.drive
    }

    /// Advances the wheel by a time step.
    pub fn step(&mut self, seconds: f64) {
        let (target, lag_s) = match self.drive {
            Drive::Velocity(velocity) => (velocity, self.lag_s),
            Drive::Brake => (0.0, self.lag_s),
            Drive::Coast => (0.0, self.coast_s),
        };
        // This step is exact for a constant target.
        let left = (-seconds / lag_s).exp();
        let before = self.velocity_radps;
        self.velocity_radps = if self.blocked { 0.0 } else { target + (before - target) * left };
        if !self.blocked {
            self.position_rad += target * seconds + (before - target) * lag_s * (1.0 - left);
        }
    }

    /// True velocity, rad/s.
    #[must_use]
    pub fn velocity_radps(&self) -> f64 {
        self.velocity_radps
    }

    /// True position, rad.
    #[must_use]
    pub fn position_rad(&self) -> f64 {
        self.position_rad
    }

    /// Velocity and position that the encoder measures.
    #[must_use]
    pub fn measured(&self) -> (f64, f64) {
        let sign = if self.encoder_reversed { -1.0 } else { 1.0 };
        (sign * self.velocity_radps, sign * (self.position_rad - self.encoder_zero_rad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wheel_that_is_released_rolls_as_far_as_its_speed_takes_it_in_its_time_constant() {
        let mut wheel = Wheel { velocity_radps: 6.0, ..Wheel::default() };
        wheel.set_drive(Drive::Coast);
        (0..10_000).for_each(|_| wheel.step(0.001));
        assert!((wheel.position_rad() - 6.0 * COAST_S).abs() < 1e-6, "{}", wheel.position_rad());
    }

    #[test]
    fn a_wheel_reaches_63_percent_after_its_time_constant_for_any_step_length() {
        for steps in [1, 10, 1000] {
            let mut wheel = Wheel::default();
            wheel.set_drive(Drive::Velocity(1.0));
            (0..steps).for_each(|_| wheel.step(wheel.lag_s / f64::from(steps)));
            assert!((wheel.velocity_radps() - (1.0 - (-1f64).exp())).abs() < 1e-9);
            assert!((wheel.position_rad() - wheel.lag_s * (-1f64).exp()).abs() < 1e-9);
        }
    }
}
