//! A robot's buffer by the system's own ssh: its keys, its configuration, its checks of the host's key, its words.

use std::io::{self, Read};
use std::os::fd::AsFd;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::{Remote, Source};
use crate::catalogue::Entry;
use crate::digest::Digest;
use crate::error::BufferError;
use crate::name::Name;
use crate::send::{Have, Receive};

/// What ssh ends with when it failed itself, ssh(1).
const SSH_FAILED: i32 = 255;

/// How ssh is called.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SshOptions {
    /// The program.
    pub program: String,
    /// Arguments before the host, such as `-p2222` or `-i/home/me/key`; each goes to ssh as it is.
    pub arguments: Vec<String>,
    /// `firmware-host` on the robot.
    pub remote_command: String,
    /// The connection counts as dead when nothing comes for this long.
    pub stall_s: u64,
}

impl Default for SshOptions {
    fn default() -> Self {
        Self {
            program: "ssh".to_owned(),
            arguments: Vec::new(),
            remote_command: "firmware-host".to_owned(),
            stall_s: 60,
        }
    }
}

/// A connection. What ssh says goes to stderr as it is.
pub struct Ssh {
    remote: Option<Remote<Patient, ChildStdin>>,
    child: Child,
}

impl Ssh {
    /// Connects and greets.
    ///
    /// # Errors
    /// When ssh cannot be started, refuses, or no `firmware-host` answers.
    pub fn connect(host: &str, path: &str, options: &SshOptions) -> Result<Self, BufferError> {
        let link = |source| BufferError::Link { to: host.to_owned(), source };
        let mut child = Command::new(&options.program)
            // No terminal and no forwarding; a link that died is noticed after a minute on this side, too.
            .args(["-T", "-x", "-oServerAliveInterval=15", "-oServerAliveCountMax=4", "-oEscapeChar=none"])
            .args(&options.arguments)
            .arg("--")
            .arg(host)
            .arg(format!("{} buffer serve -- {}", options.remote_command, quoted(path)))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| {
                link(io::Error::new(error.kind(), format!("cannot start {}: {error}", options.program)))
            })?;
        let (Some(input), Some(output)) = (child.stdout.take(), child.stdin.take()) else {
            return Err(link(io::ErrorKind::BrokenPipe.into()));
        };
        // Fewer turns between ssh and us; where it is not allowed, the usual 64 KiB do.
        let _ = rustix::pipe::fcntl_setpipe_size(&input, 1 << 20);
        // A person may have to type a password first.
        let mut connection = Self { remote: None, child };
        match Remote::greet(host, Patient { input, stall_s: options.stall_s }, output, options.stall_s) {
            Ok(remote) => connection.remote = Some(remote),
            Err(BufferError::Silent { from, .. } | BufferError::Link { to: from, .. }) => {
                return Err(match connection.child.wait() {
                    Ok(status) if status.code() == Some(SSH_FAILED) => {
                        BufferError::Unreached { host: host.to_owned(), status: status.to_string() }
                    }
                    Ok(status) => BufferError::Silent { from, status: format!(" ({status})") },
                    Err(_) => BufferError::Silent { from, status: String::new() },
                });
            }
            Err(error) => return Err(error),
        }
        Ok(connection)
    }

    fn remote(&mut self) -> Result<&mut Remote<Patient, ChildStdin>, BufferError> {
        self.remote.as_mut().ok_or_else(|| BufferError::Silent { from: "ssh".to_owned(), status: String::new() })
    }
}

impl Drop for Ssh {
    fn drop(&mut self) {
        // Its input ends, so the robot's side ends by itself.
        self.remote = None;
        // A link that hangs does not; ssh may be gone already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Source for Ssh {
    fn list(&mut self) -> Result<Vec<Entry>, BufferError> {
        self.remote()?.list()
    }

    fn fetch(
        &mut self,
        name: &Name,
        have: Have,
        to: &mut dyn Receive<BufferError>,
    ) -> Result<Option<Digest>, BufferError> {
        self.remote()?.fetch(name, have, to)
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), BufferError> {
        self.remote()?.mark_pulled(name, digest)
    }
}

/// Waits for data, but not for ever.
struct Patient {
    input: ChildStdout,
    stall_s: u64,
}

impl Read for Patient {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let timeout = Timespec { tv_sec: i64::try_from(self.stall_s).unwrap_or(i64::MAX), tv_nsec: 0 };
        let ready = poll(&mut [PollFd::from_borrowed_fd(self.input.as_fd(), PollFlags::IN)], Some(&timeout))?;
        if ready == 0 {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.input.read(buffer)
    }
}

/// For the robot's shell: one word, whatever is in it. Only a `~/` in front keeps its meaning.
fn quoted(path: &str) -> String {
    let (home, rest) = path.strip_prefix("~/").map_or(("", path), |rest| ("~/", rest));
    format!("{home}'{}'", rest.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_one_word_for_any_shell() {
        for (path, word) in [
            ("/var/lib/runs", "'/var/lib/runs'"),
            ("a b; rm -rf $HOME", "'a b; rm -rf $HOME'"),
            ("it's", "'it'\\''s'"),
            ("~/runs", "~/'runs'"),
        ] {
            assert_eq!(quoted(path), word);
        }
        let shell = Command::new("sh").arg("-c").arg(format!("printf %s {}", quoted("it's $(id) `id` \\ \""))).output();
        assert_eq!(shell.unwrap().stdout, b"it's $(id) `id` \\ \"");
    }
}
