//! A base that misbehaves.

use hal::{Base, DriveCommand, ErrorType, WheelFeedback};

use crate::{Seconds, holds};

/// What goes wrong, and when.
#[derive(Debug, Clone, Default)]
pub struct BaseFaults {
    /// Odometry is NaN: a broken encoder.
    pub nan_odometry: Option<Seconds>,
    /// Feedback stops.
    pub silent: Option<Seconds>,
    /// The base reports a touch although nothing is there: a stuck bumper switch.
    pub stuck_switch: Option<Seconds>,
    /// Odometry jumps by this much along x at this time, seconds and metres: a reset or a lost wheel.
    pub jump: Option<(f64, f64)>,
}

/// The wrapper.
#[derive(Debug)]
pub struct FaultyBase<B> {
    inner: B,
    faults: BaseFaults,
}

impl<B> FaultyBase<B> {
    /// Wraps a base.
    pub fn new(inner: B, faults: BaseFaults) -> Self {
        Self { inner, faults }
    }
}

impl<B: ErrorType> ErrorType for FaultyBase<B> {
    type Error = B::Error;
}

impl<B: Base> Base for FaultyBase<B> {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), Self::Error> {
        self.inner.drive(command)
    }

    fn stop(&mut self) -> Result<(), Self::Error> {
        self.inner.stop()
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Self::Error> {
        let Some(mut feedback) = self.inner.poll_feedback()? else { return Ok(None) };
        if holds(self.faults.silent.as_ref(), feedback.time_ns) {
            return Ok(None);
        }
        if holds(self.faults.nan_odometry.as_ref(), feedback.time_ns) {
            feedback.odom.x_m = f64::NAN;
        }
        feedback.contact |= holds(self.faults.stuck_switch.as_ref(), feedback.time_ns);
        if let Some((when_s, jump_m)) = self.faults.jump
            && feedback.time_ns as f64 * 1e-9 >= when_s
        {
            feedback.odom.x_m += jump_m;
        }
        Ok(Some(feedback))
    }
}
