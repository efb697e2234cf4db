//! A store that is reached through the system's ssh program, with its keys, configuration, host key checks and messages.

use std::io::{self, Read};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::interface::{Listing, Source};
use super::remote::Remote;
use super::ssh_config::SshConfig;
use crate::cpu_features::CpuFeatures;
use crate::digest::Digest;
use crate::error::StoreError;
use crate::name::Name;
use crate::transfer::{FileSink, LocalCopy};

/// The exit status with which ssh reports its own errors, ssh(1).
const SSH_FAILED: i32 = 255;

/// Fewer bytes than this are not worth a second connection, which takes ssh a quarter of a second or more.
const MANY_BYTES: u64 = 64 << 20;

/// How ssh is run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SshOptions {
    /// The name or path of the ssh program.
    pub program: String,
    /// Arguments before the host, such as `-p2222` or `-i/home/me/key`, passed to ssh unchanged.
    pub arguments: Vec<String>,
    /// The command that runs `firmware-host` on the robot.
    pub remote_command: String,
    /// The connection counts as dead when nothing is received for this long.
    pub stall_s: u64,
    /// Reuse a connection that an earlier call left open, and leave this one open for a minute. This needs `XDG_RUNTIME_DIR`
    /// for the socket, and is skipped when the user's ssh configuration sets its own `ControlPath`.
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

/// A connection over ssh. The messages of ssh go to standard error unchanged.
pub struct Ssh {
    remote: Option<Remote<TimeoutReader, ChildStdin>>,
    child: Child,
    /// How to reconnect with ssh's own choice of ciphers, if AES was put in front of them.
    without_aes: Option<Reconnect>,
}

/// The arguments of a connection with ssh's own choice of ciphers.
struct Reconnect {
    host: String,
    path: String,
    options: SshOptions,
}

impl Ssh {
    /// Connects and opens a session. Of the ciphers that the configuration allows, AES is preferred when the local processor
    /// has it in hardware. If the robot's processor does not, the connection is replaced as soon as much is to be fetched.
    ///
    /// # Errors
    /// When ssh cannot be started or fails, or `firmware-host` does not answer.
    pub fn connect(host: &str, path: &str, options: &SshOptions) -> Result<Self, StoreError> {
        let config = SshConfig::read(host, &options.program, &options.arguments);
        let aes =
            config.as_ref().filter(|_| CpuFeatures::detect().aes).and_then(SshConfig::aes_first);
        let runtime_dir =
            std::env::var_os("XDG_RUNTIME_DIR").filter(|_| options.share).map(PathBuf::from);
        let mut more = config.map(|config| config.sharing(runtime_dir)).unwrap_or_default();
        let without_aes = aes.is_some().then(|| Reconnect {
            host: host.into(),
            path: path.into(),
            options: options.clone(),
        });
        more.extend(aes);
        let mut connection = Self::start(host, path, options, &more)?;
        connection.without_aes = without_aes;
        Ok(connection)
    }

    /// Starts ssh. The arguments in `more` come after those of `options`, which take precedence.
    fn start(
        host: &str,
        path: &str,
        options: &SshOptions,
        more: &[String],
    ) -> Result<Self, StoreError> {
        let mut child = Command::new(&options.program)
            // No terminal and no X11 forwarding; ssh ends a dead connection after a minute.
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
                let text = format!("cannot start {}: {error}", options.program);
                link_error(host, io::Error::new(error.kind(), text))
            })?;
        let input = child.stdout.take().ok_or_else(|| no_pipe(host))?;
        let output = child.stdin.take().ok_or_else(|| no_pipe(host))?;
        // A larger pipe needs fewer context switches; where the system refuses, the default of 64 KiB is enough.
        let _ = rustix::pipe::fcntl_setpipe_size(&input, 1 << 20);
        let mut connection = Self { remote: None, child, without_aes: None };
        match Remote::greet(
            host,
            TimeoutReader { input, stall_s: options.stall_s },
            output,
            options.stall_s,
        ) {
            Ok(remote) => connection.remote = Some(remote),
            Err(StoreError::Silent { from, .. } | StoreError::Link { to: from, .. }) => {
                return Err(match connection.child.wait() {
                    Ok(status) if status.code() == Some(SSH_FAILED) => {
                        StoreError::Unreached { host: host.to_owned(), status: status.to_string() }
                    }
                    Ok(status) => StoreError::Silent { from, status: format!(" ({status})") },
                    Err(_) => StoreError::Silent { from, status: String::new() },
                });
            }
            Err(error) => return Err(error),
        }
        Ok(connection)
    }

    fn remote(&mut self) -> Result<&mut Remote<TimeoutReader, ChildStdin>, StoreError> {
        self.remote
            .as_mut()
            .ok_or_else(|| StoreError::Silent { from: "ssh".to_owned(), status: String::new() })
    }
}

impl Reconnect {
    /// Connects without prompts and messages: the first connection still works if this fails.
    fn connect(mut self) -> Result<Ssh, StoreError> {
        // ssh uses the first of several values of an option.
        let quiet =
            ["-oBatchMode=yes", "-oLogLevel=QUIET", "-oControlPath=none"].map(str::to_owned);
        self.options.arguments.splice(..0, quiet);
        Ssh::start(&self.host, &self.path, &self.options, &[])
    }
}

fn link_error(host: &str, source: io::Error) -> StoreError {
    StoreError::Link { to: host.to_owned(), source }
}

fn no_pipe(host: &str) -> StoreError {
    link_error(host, io::ErrorKind::BrokenPipe.into())
}

impl Drop for Ssh {
    fn drop(&mut self) {
        // Closes the input of the robot's side, which then ends.
        self.remote = None;
        // If the link hangs, ssh does not end without a signal. It may also have ended already, so errors are ignored.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Source for Ssh {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.remote()?.list()
    }

    fn expect(&mut self, bytes: u64) {
        if bytes < MANY_BYTES {
            return;
        }
        let Some(reconnect) = self.without_aes.take() else { return };
        // An error here appears again with the next request.
        let Ok(cpu) = self.remote().and_then(Remote::cpu_features) else { return };
        if cpu.is_some_and(|cpu| cpu.aes) {
            return;
        }
        if let Ok(faster) = reconnect.connect() {
            *self = faster;
        }
    }

    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        self.remote()?.fetch(name, local, to)
    }

    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.remote()?.mark_pulled(name, digest)
    }
}

/// Reads with a timeout.
struct TimeoutReader {
    input: ChildStdout,
    stall_s: u64,
}

impl Read for TimeoutReader {
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

/// Quotes a path as one word for the robot's shell. A leading `~/` keeps its meaning.
fn quoted(path: &str) -> String {
    let (home, rest) = path.strip_prefix("~/").map_or(("", path), |rest| ("~/", rest));
    format!("{home}'{}'", rest.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quoted_path_is_one_word_for_the_shell() {
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
