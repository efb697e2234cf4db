//! Commands for the system's ssh, and for rsync and `pull-buffer` over it, with the test's own server on loopback.

use std::path::Path;
use std::process::{Command, Stdio};

use hil::sshd::Sshd;

/// An `ssh` command to the server, up to the host name.
#[must_use]
pub fn ssh(server: &Sshd) -> Command {
    let mut command = Command::new("ssh");
    command.args(server.options()).arg("127.0.0.1");
    command
}

/// An ssh option that selects a cipher with hardware support in most processors.
pub const AES: &[&str] = &["-caes128-gcm@openssh.com"];

/// ssh options with which the first command opens a connection that the next ones reuse, as `ControlMaster auto` in
/// ~/.ssh/config.
#[must_use]
pub fn shared_connection(server: &Sshd) -> Vec<String> {
    let socket = server.dir().join("%C");
    [
        "-oControlMaster=auto".to_owned(),
        "-oControlPersist=60".to_owned(),
        format!("-oControlPath={}", socket.display()),
    ]
    .into()
}

/// How rsync detects changed files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Comparison {
    /// rsync compares size and time, as `rsync -a` does by default.
    SizeAndTime,
    /// rsync compares the checksum of the whole content, which both sides read: `rsync -a --checksum`.
    Checksum,
}

impl Comparison {
    /// The rsync command as text.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SizeAndTime => "rsync -a",
            Self::Checksum => "rsync -a --checksum",
        }
    }
}

/// An `rsync -a` command that copies `from` on the server to `to`.
#[must_use]
pub fn rsync(
    server: &Sshd,
    more: &[impl AsRef<str>],
    comparison: Comparison,
    from: &Path,
    to: &Path,
) -> Command {
    let mut command = Command::new("rsync");
    let more = more.iter().map(|option| format!(" {}", option.as_ref())).collect::<String>();
    if comparison == Comparison::Checksum {
        command.arg("--checksum");
    }
    command.args(["-a", "-e", &format!("ssh {}{more}", server.options().join(" "))]);
    command.arg(format!("127.0.0.1:{}/", from.display())).arg(format!("{}/", to.display()));
    command
}

/// A `pull-buffer` command that copies `from` on the server to `to`.
#[must_use]
pub fn pull(
    server: &Sshd,
    more: &[impl AsRef<str>],
    programs: &Path,
    from: &Path,
    to: &Path,
) -> Command {
    let mut command = Command::new(programs.join("pull-buffer"));
    command.arg(format!("127.0.0.1:{}", from.display())).arg(to);
    command.arg(format!("--program={}", programs.join("firmware-host").display()));
    command.args(server.options().iter().map(|option| format!("--ssh={option}")));
    command.args(more.iter().map(|option| format!("--ssh={}", option.as_ref())));
    // Without a runtime directory, every call opens a new connection.
    command.env_remove("XDG_RUNTIME_DIR").stderr(Stdio::null());
    command
}
