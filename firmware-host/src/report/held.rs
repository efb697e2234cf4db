//! Frames in which the safety plane held the robot.

use runtime::tick::Command;

/// Counts the frames in which the robot did not move as the plan asked: it stood, backed off, or rotated only. A robot that is
/// merely slower is not held.
#[derive(Debug, Clone, Default)]
pub struct HeldMeter {
    /// The plan of the previous frame.
    desired: Option<Command>,
    held: u64,
}

impl HeldMeter {
    /// Adds a frame: the plan that was made in it, and the command that was in force when it began, which answers the plan of the
    /// frame before.
    pub fn frame(&mut self, desired: Command, sent: Option<Command>) {
        let before = self.desired.replace(desired);
        let is_held = before.zip(sent).is_some_and(|(desired, sent)| holds(&desired, &sent));
        self.held += u64::from(is_held);
    }

    /// Number of such frames so far.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.held
    }
}

fn holds(desired: &Command, sent: &Command) -> bool {
    if desired.linear_mps > 0.0 {
        return sent.linear_mps <= 0.0;
    }
    *desired != Command::default() && *sent == Command::default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn command(linear_mps: f64, angular_radps: f64) -> Command {
        Command { linear_mps, angular_radps }
    }

    const STOP: Command = command(0.0, 0.0);
    const AHEAD: Command = command(0.3, 0.1);

    /// Frames that count when this plan is answered by this command.
    fn held(desired: Command, sent: Command) -> u64 {
        let mut meter = HeldMeter::default();
        meter.frame(desired, Some(STOP));
        meter.frame(STOP, Some(sent));
        meter.frames()
    }

    #[test]
    fn a_robot_that_stands_backs_off_or_only_rotates_is_held_and_one_that_is_slower_is_not() {
        assert_eq!(held(AHEAD, STOP), 1);
        assert_eq!(held(AHEAD, command(-0.2, 0.0)), 1);
        assert_eq!(held(AHEAD, command(0.0, 0.1)), 1);
        assert_eq!(held(AHEAD, command(0.1, 0.03)), 0);
        assert_eq!(held(command(0.0, 0.5), STOP), 1);
        assert_eq!(held(command(0.0, 0.5), command(0.0, 0.2)), 0);
        assert_eq!(held(STOP, STOP), 0);
    }

    #[test]
    fn a_frame_without_a_command_and_the_first_one_are_not_counted() {
        let mut meter = HeldMeter::default();
        meter.frame(AHEAD, Some(STOP));
        meter.frame(AHEAD, None);
        assert_eq!(meter.frames(), 0);
    }
}
