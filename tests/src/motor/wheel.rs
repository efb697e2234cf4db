//! A wheel with its motor: answers with a lag of first order.

/// What the controller does to the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// Follows a velocity, rad/s.
    Velocity(f64),
    /// Holds the motor short-circuited or against zero.
    Brake,
    /// Lets it go: friction alone.
    Coast,
}

/// One wheel, gear 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Wheel {
    drive: Drive,
    velocity_radps: f64,
    position_rad: f64,
    /// Time constant while driven and braked, s.
    pub lag_s: f64,
    /// Time constant of rolling out, s.
    pub coast_s: f64,
    /// Cannot turn: it stands against something.
    pub blocked: bool,
    /// Its encoder counts the other way round.
    pub encoder_reversed: bool,
}

impl Default for Wheel {
    /// A geared home robot's wheel.
    fn default() -> Self {
        Self {
            drive: Drive::Coast,
            velocity_radps: 0.0,
            position_rad: 0.0,
            lag_s: 0.03,
            coast_s: 0.05,
            blocked: false,
            encoder_reversed: false,
        }
    }
}

impl Wheel {
    /// What the controller does from now on.
    pub fn set_drive(&mut self, drive: Drive) {
        self.drive = drive;
    }

    /// What the controller does.
    #[must_use]
    pub fn drive(&self) -> Drive {
        self.drive
    }

    /// Time passes.
    pub fn step(&mut self, seconds: f64) {
        let (target, lag_s) = match self.drive {
            Drive::Velocity(velocity) => (velocity, self.lag_s),
            Drive::Brake => (0.0, self.lag_s),
            Drive::Coast => (0.0, self.coast_s),
        };
        // Exact for a target that stays.
        let left = (-seconds / lag_s).exp();
        let before = self.velocity_radps;
        self.velocity_radps = if self.blocked { 0.0 } else { target + (before - target) * left };
        if !self.blocked {
            self.position_rad += target * seconds + (before - target) * lag_s * (1.0 - left);
        }
    }

    /// How it really turns, rad/s.
    #[must_use]
    pub fn velocity_radps(&self) -> f64 {
        self.velocity_radps
    }

    /// How far it has really turned, rad.
    #[must_use]
    pub fn position_rad(&self) -> f64 {
        self.position_rad
    }

    /// Velocity and position as its encoder tells them.
    #[must_use]
    pub fn measured(&self) -> (f64, f64) {
        let sign = if self.encoder_reversed { -1.0 } else { 1.0 };
        (sign * self.velocity_radps, sign * self.position_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wheel_reaches_63_percent_after_its_time_constant_whatever_the_step() {
        for steps in [1, 10, 1000] {
            let mut wheel = Wheel::default();
            wheel.set_drive(Drive::Velocity(1.0));
            (0..steps).for_each(|_| wheel.step(wheel.lag_s / f64::from(steps)));
            assert!((wheel.velocity_radps() - (1.0 - (-1f64).exp())).abs() < 1e-9);
            assert!((wheel.position_rad() - wheel.lag_s * (-1f64).exp()).abs() < 1e-9);
        }
    }
}
