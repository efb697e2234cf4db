//! The system's own ssh, rsync over it, and `pull-buffer` over it, to a server of our own on loopback.

use std::path::Path;
use std::process::{Command, Stdio};

use hil::sshd::Sshd;

/// `ssh` to it, up to the host.
#[must_use]
pub fn ssh(server: &Sshd) -> Command {
    let mut command = Command::new("ssh");
    command.args(server.options()).arg("127.0.0.1");
    command
}

/// `rsync -a --checksum` from it.
#[must_use]
pub fn rsync(server: &Sshd, from: &Path, to: &Path) -> Command {
    let mut command = Command::new("rsync");
    command.args(["-a", "--checksum", "-e", &format!("ssh {}", server.options().join(" "))]);
    command.arg(format!("127.0.0.1:{}/", from.display())).arg(format!("{}/", to.display()));
    command
}

/// `pull-buffer` from it.
#[must_use]
pub fn pull(server: &Sshd, programs: &Path, from: &Path, to: &Path) -> Command {
    let mut command = Command::new(programs.join("pull-buffer"));
    command.arg(format!("127.0.0.1:{}", from.display())).arg(to);
    command.arg(format!("--remote-command={}", programs.join("firmware-host").display()));
    command.args(server.options().iter().map(|option| format!("--ssh-option={option}")));
    command.stderr(Stdio::null());
    command
}
