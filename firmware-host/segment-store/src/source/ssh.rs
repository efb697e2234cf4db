//! A robot's buffer by the system's own ssh: its keys, its configuration, its checks of the host's key, its words.

use std::io::{self, Read};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::ssh_config::SshConfig;
use super::{Remote, Source};
use crate::catalogue::Entry;
use crate::computer::Computer;
use crate::digest::Digest;
use crate::error::BufferError;
use crate::name::Name;
use crate::send::{Have, Receive};

/// What ssh ends with when it failed itself, ssh(1).
const SSH_FAILED: i32 = 255;

/// Fewer bytes than these are not worth a second greeting, which takes ssh a quarter of a second and more.
const MANY_BYTES: u64 = 64 << 20;

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
    /// Use a connection that an earlier call has left open, and leave one open for a minute: where the system has
    /// `XDG_RUNTIME_DIR` for its socket, and the person's configuration of ssh no way of its own.
    pub share: bool,
}

impl Default for SshOptions {
    fn default() -> Self {
        Self {
            program: "ssh".to_owned(),
            arguments: Vec::new(),
            remote_command: "firmware-host".to_owned(),
            stall_s: 60,
            share: true,
        }
    }
}

/// A connection. What ssh says goes to stderr as it is.
pub struct Ssh {
    remote: Option<Remote<Patient, ChildStdin>>,
    child: Child,
    /// How to connect again as ssh would by itself, if AES was put in front of its ciphers.
    plain: Option<Plain>,
}

/// A connection with nothing but ssh's own choices.
struct Plain {
    host: String,
    path: String,
    options: SshOptions,
}

impl Ssh {
    /// Connects and greets. Of the ciphers that the configuration allows, AES is asked for first where this computer has it in
    /// hardware; a robot that has not is asked again, without, as soon as much is to be fetched.
    ///
    /// # Errors
    /// When ssh cannot be started, refuses, or no `firmware-host` answers.
    pub fn connect(host: &str, path: &str, options: &SshOptions) -> Result<Self, BufferError> {
        let config = SshConfig::read(host, options);
        let aes = config.as_ref().filter(|_| Computer::this().aes).and_then(SshConfig::aes_first);
        let runtime_dir =
            std::env::var_os("XDG_RUNTIME_DIR").filter(|_| options.share).map(PathBuf::from);
        let mut more = config.map(|config| config.sharing(runtime_dir)).unwrap_or_default();
        let plain = aes.is_some().then(|| Plain {
            host: host.into(),
            path: path.into(),
            options: options.clone(),
        });
        more.extend(aes);
        let mut connection = Self::start(host, path, options, &more)?;
        connection.plain = plain;
        Ok(connection)
    }

    /// `more` gives way to what the options say.
    fn start(
        host: &str,
        path: &str,
        options: &SshOptions,
        more: &[String],
    ) -> Result<Self, BufferError> {
        let link = |source| BufferError::Link { to: host.to_owned(), source };
        let mut child = Command::new(&options.program)
            // No terminal and no forwarding; a link that died is noticed after a minute on this side, too.
            .args([
                "-T",
                "-x",
                "-oServerAliveInterval=15",
                "-oServerAliveCountMax=4",
                "-oEscapeChar=none",
            ])
            .args(&options.arguments)
            .args(more)
            .arg("--")
            .arg(host)
            .arg(format!("{} buffer serve -- {}", options.remote_command, quoted(path)))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| {
                link(io::Error::new(
                    error.kind(),
                    format!("cannot start {}: {error}", options.program),
                ))
            })?;
        let (Some(input), Some(output)) = (child.stdout.take(), child.stdin.take()) else {
            return Err(link(io::ErrorKind::BrokenPipe.into()));
        };
        // Fewer turns between ssh and us; where it is not allowed, the usual 64 KiB do.
        let _ = rustix::pipe::fcntl_setpipe_size(&input, 1 << 20);
        // A person may have to type a password first.
        let mut connection = Self { remote: None, child, plain: None };
        match Remote::greet(
            host,
            Patient { input, stall_s: options.stall_s },
            output,
            options.stall_s,
        ) {
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
        self.remote
            .as_mut()
            .ok_or_else(|| BufferError::Silent { from: "ssh".to_owned(), status: String::new() })
    }
}

impl Plain {
    /// Without a word and without a question: there is a connection that works.
    fn connect(mut self) -> Result<Ssh, BufferError> {
        // The first of two values counts for ssh.
        let quiet =
            ["-oBatchMode=yes", "-oLogLevel=QUIET", "-oControlPath=none"].map(str::to_owned);
        self.options.arguments.splice(..0, quiet);
        Ssh::start(&self.host, &self.path, &self.options, &[])
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

    fn expect(&mut self, bytes: u64) {
        if bytes < MANY_BYTES {
            return;
        }
        let Some(plain) = self.plain.take() else { return };
        // An error says itself with the next request.
        let Ok(computer) = self.remote().and_then(Remote::computer) else { return };
        if computer.is_some_and(|computer| computer.aes) {
            return;
        }
        if let Ok(faster) = plain.connect() {
            *self = faster;
        }
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
        let timeout =
            Timespec { tv_sec: i64::try_from(self.stall_s).unwrap_or(i64::MAX), tv_nsec: 0 };
        let ready = poll(
            &mut [PollFd::from_borrowed_fd(self.input.as_fd(), PollFlags::IN)],
            Some(&timeout),
        )?;
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
        let shell = Command::new("sh")
            .arg("-c")
            .arg(format!("printf %s {}", quoted("it's $(id) `id` \\ \"")))
            .output();
        assert_eq!(shell.unwrap().stdout, b"it's $(id) `id` \\ \"");
    }
}
