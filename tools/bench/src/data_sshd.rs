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

/// More options for both: a cipher that most processors have in hardware.
pub const AES: &[&str] = &["-caes128-gcm@openssh.com"];

/// More options for both: the first opens a connection that the next ones use, as `ControlMaster auto` in ~/.ssh/config.
#[must_use]
pub fn kept(server: &Sshd) -> Vec<String> {
    let socket = server.dir().join("%C");
    [
        "-oControlMaster=auto".to_owned(),
        "-oControlPersist=60".to_owned(),
        format!("-oControlPath={}", socket.display()),
    ]
    .into()
}

/// `rsync -a --checksum` from it.
#[must_use]
pub fn rsync(server: &Sshd, more: &[impl AsRef<str>], from: &Path, to: &Path) -> Command {
    let mut command = Command::new("rsync");
    let more = more.iter().map(|option| format!(" {}", option.as_ref())).collect::<String>();
    command.args(["-a", "--checksum", "-e", &format!("ssh {}{more}", server.options().join(" "))]);
    command.arg(format!("127.0.0.1:{}/", from.display())).arg(format!("{}/", to.display()));
    command
}

/// `pull-buffer` from it.
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
    command.arg(format!("--remote-command={}", programs.join("firmware-host").display()));
    command.args(server.options().iter().map(|option| format!("--ssh-option={option}")));
    command.args(more.iter().map(|option| format!("--ssh-option={}", option.as_ref())));
    // It greets anew unless told otherwise.
    command.env_remove("XDG_RUNTIME_DIR").stderr(Stdio::null());
    command
}
