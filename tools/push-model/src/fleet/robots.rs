//! Asking robots and sending to them, over the system's ssh or on this computer.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use signed_model::Bundle;

use super::answer::{Judged, Listed, clean, read_install, read_list};
use super::file::{Fleet, Robot};

/// Options of ssh after those of the operator, which have precedence: nothing waits for a password, nor long for a robot that is
/// switched off or leaves the network.
const SSH_OPTIONS: [&str; 3] =
    ["-oBatchMode=yes", "-oConnectTimeout=20", "-oServerAliveInterval=15"];
/// The exit code of ssh itself, when the connection failed.
const SSH_FAILED: i32 = 255;

/// What a robot said when it was asked for its models.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Asked {
    Listed(Listed),
    /// Its program ran and gave no list: it has no store yet, or a wrong configuration.
    NoList {
        why: String,
    },
    /// The robot could not be reached, or its store is damaged.
    Unreachable {
        why: String,
    },
}

/// What came of sending the model to a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sent {
    Judged(Judged),
    /// The robot did not get the model, or its program ended without a verdict.
    NotArrived {
        why: String,
    },
    /// The robot may have the model and be judging it.
    Unknown {
        why: String,
    },
}

/// The robots of a fleet, by name.
pub trait Robots: Sync {
    /// Asks a robot for its models.
    fn ask(&self, name: &str) -> Asked;
    /// Sends the model to a robot and waits for the verdict of its gate.
    fn send(&self, name: &str) -> Sent;
}

/// The robots that ssh reaches, and those whose store is on this computer.
pub struct RealRobots<'a> {
    pub fleet: &'a Fleet,
    /// BLAKE3 digest of the model, hexadecimal.
    pub digest: &'a str,
    /// The model; `None` if nothing is to be sent.
    pub bundle: Option<&'a Bundle>,
    /// The command that runs the robot's program.
    pub program: &'a str,
    pub ssh: &'a [String],
    /// Arguments for the robot's gate.
    pub gate: &'a [String],
}

impl Robots for RealRobots<'_> {
    fn ask(&self, name: &str) -> Asked {
        let Some(robot) = self.fleet.robot(name) else {
            return Asked::Unreachable { why: "it is not in the fleet's file".to_owned() };
        };
        let mut command = self.command(robot, &robot.target.list_arguments(self.gate));
        match command.stdin(Stdio::null()).output() {
            Err(error) => Asked::Unreachable { why: cannot_start(&command, &error) },
            Ok(output) => {
                let said = String::from_utf8_lossy(&output.stdout);
                match read_list(&said, self.digest) {
                    Some(Ok(listed)) => Asked::Listed(listed),
                    Some(Err(why)) => Asked::Unreachable { why },
                    None if has_run(&output) => Asked::NoList { why: last_words(&output) },
                    None => Asked::Unreachable { why: last_words(&output) },
                }
            }
        }
    }

    fn send(&self, name: &str) -> Sent {
        let (Some(robot), Some(bundle)) = (self.fleet.robot(name), self.bundle) else {
            return Sent::NotArrived { why: "there is nothing to send".to_owned() };
        };
        let mut command = self.command(robot, &robot.target.install_arguments(self.gate));
        match deliver(&mut command, bundle) {
            Err(error) => Sent::NotArrived { why: cannot_start(&command, &error) },
            Ok((output, is_complete)) => {
                let said = String::from_utf8_lossy(&output.stdout);
                match read_install(&said) {
                    Some(judged) => Sent::Judged(judged),
                    None if has_run(&output) || !is_complete => {
                        Sent::NotArrived { why: last_words(&output) }
                    }
                    None => Sent::Unknown { why: last_words(&output) },
                }
            }
        }
    }
}

impl RealRobots<'_> {
    fn command(&self, robot: &Robot, arguments: &[String]) -> Command {
        let mut ssh = self.ssh.to_vec();
        ssh.extend(SSH_OPTIONS.map(str::to_owned));
        let mut command = robot.target.command(self.program, &ssh);
        command.args(arguments).arg("--json");
        command
    }
}

/// Runs a command with the model as its input. Returns what it said, and whether it took the model completely.
fn deliver(command: &mut Command, bundle: &Bundle) -> std::io::Result<(Output, bool)> {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn()?;
    let input = child.stdin.take();
    std::thread::scope(|scope| {
        let writer = scope.spawn(move || {
            input.is_some_and(|mut input| {
                bundle.write_stream(&mut input).and_then(|()| input.flush()).is_ok()
            })
        });
        let output = child.wait_with_output()?;
        Ok((output, writer.join().unwrap_or(false)))
    })
}

/// Whether the robot's program ran and ended, so that it is not judging the model any more.
fn has_run(output: &Output) -> bool {
    output.status.code().is_some_and(|code| code != SSH_FAILED)
}

fn cannot_start(command: &Command, error: &std::io::Error) -> String {
    format!("cannot start {}: {error}", command.get_program().display())
}

/// The last line that a program wrote on standard error, which says why it failed.
fn last_words(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr);
    match said.lines().rev().find(|line| !line.trim().is_empty()) {
        Some(line) => clean(line),
        None => format!("no answer ({})", output.status),
    }
}
