//! What people do to a robot by hand: they carry it, push it, or hold it so that its wheels spin.
//!
//! A line of text names each of these. `hil world` reads such lines from a named pipe.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::str::FromStr;

use hal::{Pose2, wrap_angle};
use rustix::fs::{CWD, FileType, Mode, OFlags, mknodat};

/// Duration of a push, seconds.
const PUSH_S: f64 = 0.5;
/// Longest push and longest time without grip.
const LONGEST_PUSH_M: f64 = 1.0;
const LONGEST_SPIN_S: f64 = 60.0;
/// Bytes of a line at most.
const LONGEST_LINE: usize = 200;
const HELP: &str = "write `carry X Y DEGREES`, `push FORWARD LEFT` (metres) or `spin SECONDS`";

/// One thing that is done to the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Handled {
    /// It is lifted and put down at this pose in the world.
    Carried(Pose2),
    /// It is pushed by so much in its own frame, within half a second.
    Pushed { forward_m: f64, left_m: f64 },
    /// Its wheels have no grip for this time: they spin, and it stands.
    WithoutGrip { seconds: f64 },
}

impl FromStr for Handled {
    type Err = String;

    fn from_str(line: &str) -> Result<Self, String> {
        let mut words = line.split_whitespace();
        let what = words.next().ok_or(HELP)?;
        let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
        let numbers =
            numbers.map_err(|_| format!("`{line}` has a word that is no number: {HELP}"))?;
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err(format!("`{line}` has a number that is not finite"));
        }
        match (what, numbers.as_slice()) {
            ("carry", [x_m, y_m, degrees]) => {
                Ok(Self::Carried(Pose2::new(*x_m, *y_m, wrap_angle(degrees.to_radians()))))
            }
            ("push", [forward_m, left_m]) if forward_m.hypot(*left_m) <= LONGEST_PUSH_M => {
                Ok(Self::Pushed { forward_m: *forward_m, left_m: *left_m })
            }
            ("push", [_, _]) => Err(format!("`{line}`: a push is at most {LONGEST_PUSH_M} m")),
            ("spin", [seconds]) if (0.0..=LONGEST_SPIN_S).contains(seconds) => {
                Ok(Self::WithoutGrip { seconds: *seconds })
            }
            ("spin", [_]) => Err(format!("`{line}`: wheels spin for 0 to {LONGEST_SPIN_S} s")),
            _ => Err(format!("`{line}` is not understood: {HELP}")),
        }
    }
}

impl std::fmt::Display for Handled {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Carried(Pose2 { x_m, y_m, yaw_rad }) => {
                let degrees = yaw_rad.to_degrees();
                write!(to, "carried to ({x_m:.2}, {y_m:.2}) m, {degrees:.0} degrees")
            }
            Self::Pushed { forward_m, left_m } => {
                write!(to, "pushed by {forward_m:.2} m ahead and {left_m:.2} m to the left")
            }
            Self::WithoutGrip { seconds } => write!(to, "the wheels have no grip for {seconds} s"),
        }
    }
}

/// A push in progress.
#[derive(Debug, Clone)]
pub(super) struct Push {
    forward_m: f64,
    left_m: f64,
    remaining_s: f64,
}

impl Push {
    pub fn new(forward_m: f64, left_m: f64) -> Self {
        Self { forward_m, left_m, remaining_s: PUSH_S }
    }

    /// The motion of the next `seconds`; `None` when the push is over.
    pub fn step(&mut self, seconds: f64) -> Option<Pose2> {
        let seconds = seconds.clamp(0.0, self.remaining_s);
        if self.remaining_s <= 0.0 {
            return None;
        }
        self.remaining_s -= seconds;
        let share = seconds / PUSH_S;
        Some(Pose2::new(share * self.forward_m, share * self.left_m, 0.0))
    }
}

/// A named pipe into which people write lines.
pub(super) struct ControlPipe {
    pipe: File,
    /// The beginning of a line.
    rest: Vec<u8>,
}

impl ControlPipe {
    /// Creates the pipe. What an earlier world has left under its name is replaced.
    ///
    /// # Errors
    /// When there can be no pipe.
    pub fn listen(path: &Path) -> std::io::Result<Self> {
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)?;
        // Open for writing too, so that it does not end when a writer leaves.
        let flags = OFlags::NONBLOCK.bits() as i32;
        let pipe = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path)?;
        Ok(Self { pipe, rest: Vec::new() })
    }

    /// The next line, if one is complete.
    pub fn next_line(&mut self) -> Option<Result<Handled, String>> {
        let mut piece = [0; 256];
        while !self.rest.contains(&b'\n') {
            match self.pipe.read(&mut piece) {
                Ok(count) if count > 0 => self.rest.extend_from_slice(&piece[..count]),
                _ => break,
            }
            if self.rest.len() > LONGEST_LINE && !self.rest.contains(&b'\n') {
                self.rest.clear();
                return Some(Err(format!("a line has more than {LONGEST_LINE} bytes: {HELP}")));
            }
        }
        let end = self.rest.iter().position(|byte| *byte == b'\n')?;
        let line: Vec<u8> = self.rest.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line).trim().parse())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_names_what_is_done_to_the_robot() {
        let quarter = Pose2::new(1.5, -2.0, std::f64::consts::FRAC_PI_2);
        let Ok(Handled::Carried(pose)) = "carry 1.5 -2 90".parse() else { panic!("not carried") };
        assert!(pose.distance_m(&quarter) + (pose.yaw_rad - quarter.yaw_rad).abs() < 1e-9);
        let pushed = Handled::Pushed { forward_m: 0.2, left_m: -0.1 };
        assert_eq!(" push 0.2  -0.1".parse(), Ok(pushed));
        assert_eq!("spin 3".parse(), Ok(Handled::WithoutGrip { seconds: 3.0 }));
    }

    #[test]
    fn a_line_that_is_not_understood_is_refused_with_the_form() {
        for line in ["", "fly 1 2", "carry 1 2", "carry 1 2 north"] {
            let refusal = line.parse::<Handled>().unwrap_err();
            assert!(refusal.contains("carry X Y DEGREES"), "{refusal}");
        }
        for (line, why) in [
            ("carry nan 1 2", "not finite"),
            ("push 2 0", "at most 1 m"),
            ("spin -1", "0 to 60 s"),
            ("spin 1e9", "0 to 60 s"),
        ] {
            assert!(line.parse::<Handled>().unwrap_err().contains(why), "{line}");
        }
    }

    #[test]
    fn a_push_ends_where_it_was_meant_to() {
        let mut push = Push::new(0.2, -0.1);
        let mut pose = Pose2::IDENTITY;
        while let Some(motion) = push.step(0.002) {
            pose = pose.compose(&motion);
        }
        assert!(pose.distance_m(&Pose2::new(0.2, -0.1, 0.0)) < 1e-9, "{pose:?}");
    }

    #[test]
    fn lines_arrive_whole_from_writers_that_come_and_go() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let mut pipe = ControlPipe::listen(&path).unwrap();
        assert!(pipe.next_line().is_none());
        std::fs::write(&path, "spin 1\nspi").unwrap();
        assert_eq!(pipe.next_line(), Some(Ok(Handled::WithoutGrip { seconds: 1.0 })));
        assert!(pipe.next_line().is_none());
        std::fs::write(&path, "n 2\n\n").unwrap();
        assert_eq!(pipe.next_line(), Some(Ok(Handled::WithoutGrip { seconds: 2.0 })));
        assert!(pipe.next_line().unwrap().is_err());
        std::fs::write(&path, [b'x'; 300]).unwrap();
        assert!(pipe.next_line().unwrap().unwrap_err().contains("more than 200"));
        drop(pipe);
        assert!(ControlPipe::listen(&path).unwrap().next_line().is_none());
    }
}
