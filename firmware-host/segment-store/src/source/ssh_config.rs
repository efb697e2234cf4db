//! The user's ssh configuration for a host, and the options that are added to it: a connection that several calls share, and
//! the fastest of the allowed ciphers.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// With AES in hardware, ssh needs 0.5 s of processor time for 1 GiB at either end; with OpenSSH's own first choice,
/// chacha20-poly1305, it needs 1.4 s (measured, x86-64, OpenSSL 3.0).
const AES: &str = "aes128-gcm@openssh.com";

/// A shared connection stays open for this long, as in Ansible.
const PERSIST_S: u32 = 60;

/// Longest path of a socket, unix(7), without the suffix that ssh appends while it creates one.
const MAX_SOCKET: usize = 108 - 1 - 17;

/// The length of ssh's `%C`, a hash of both hosts, the port and the user.
const HASH: usize = 40;

/// The relevant part of the output of `ssh -G`.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SshConfig {
    ciphers: Vec<String>,
    /// The configuration already sets a `ControlPath`.
    shares: bool,
}

impl SshConfig {
    /// Runs `ssh -G`. `None` when that fails; no option is added then.
    pub(super) fn read(host: &str, program: &str, arguments: &[String]) -> Option<Self> {
        let mut ssh = Command::new(program);
        ssh.arg("-G")
            .args(arguments)
            .arg("--")
            .arg(host)
            .stdin(Stdio::null())
            .stderr(Stdio::null());
        let output = ssh.output().ok().filter(|output| output.status.success())?;
        Some(Self::parse(&String::from_utf8_lossy(&output.stdout)))
    }

    fn parse(text: &str) -> Self {
        let ciphers = value_of(text, "ciphers").unwrap_or_default();
        Self {
            ciphers: ciphers.split(',').map(str::to_owned).collect(),
            shares: value_of(text, "controlpath").is_some(),
        }
    }

    /// The option that puts AES in front of the other allowed ciphers; `None` when AES is not allowed or is the first already.
    pub(super) fn aes_first(&self) -> Option<String> {
        let at = self.ciphers.iter().position(|cipher| cipher == AES).filter(|at| *at > 0)?;
        let mut ciphers = self.ciphers.clone();
        let aes = ciphers.remove(at);
        ciphers.insert(0, aes);
        Some(format!("-oCiphers={}", ciphers.join(",")))
    }

    /// Options that let calls of this user share a connection for a minute. Empty when the configuration sets its own
    /// `ControlPath`, or there is no directory for sockets.
    pub(super) fn sharing(&self, runtime_dir: Option<PathBuf>) -> Vec<String> {
        let socket = runtime_dir
            .filter(|dir| dir.is_absolute() && !self.shares)
            .and_then(|dir| socket_in(&dir));
        let Some(socket) = socket else { return Vec::new() };
        vec![
            "-oControlMaster=auto".to_owned(),
            format!("-oControlPersist={PERSIST_S}"),
            format!("-oControlPath={socket}"),
        ]
    }
}

fn value_of<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(' '))
}

/// The `ControlPath` in our directory; `None` when that cannot be created, is too long, or contains characters that ssh expands.
fn socket_in(runtime_dir: &Path) -> Option<String> {
    let dir = runtime_dir.join("embodied-depth");
    let text = dir.to_str().filter(|text| {
        text.len() + 1 + HASH <= MAX_SOCKET && !text.contains(['%', '"', ' ', '$'])
    })?;
    // Only the user can access the directory above (XDG Base Directory Specification).
    std::fs::create_dir_all(&dir).ok()?;
    Some(format!("{text}/%C"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CIPHERS: &str = "ciphers chacha20-poly1305@openssh.com,aes128-ctr,aes128-gcm@openssh.com,aes256-gcm@openssh.com";

    #[test]
    fn aes_moves_in_front_of_the_allowed_ciphers_and_no_cipher_is_added() {
        let config = SshConfig::parse(&format!("host robot\n{CIPHERS}\nport 22\n"));
        let expected = "-oCiphers=aes128-gcm@openssh.com,chacha20-poly1305@openssh.com,aes128-ctr,aes256-gcm@openssh.com";
        assert_eq!(config.aes_first().unwrap(), expected);
        for settled in [
            "ciphers aes128-gcm@openssh.com,aes128-ctr",
            "ciphers chacha20-poly1305@openssh.com",
            "",
        ] {
            assert_eq!(SshConfig::parse(settled).aes_first(), None, "{settled}");
        }
    }

    #[test]
    fn a_connection_is_shared_unless_the_configuration_sets_its_own_control_path() {
        let dir = tempfile::tempdir().unwrap();
        let runtime_dir = Some(dir.path().to_owned());
        let options = SshConfig::parse(CIPHERS).sharing(runtime_dir.clone());
        assert!(
            options.contains(&format!("-oControlPath={}/embodied-depth/%C", dir.path().display())),
            "{options:?}"
        );
        assert!(dir.path().join("embodied-depth").is_dir());
        let own = SshConfig::parse("controlmaster auto\ncontrolpath /home/me/.ssh/x\n");
        assert!(own.sharing(runtime_dir).is_empty());
        assert!(SshConfig::parse(CIPHERS).sharing(None).is_empty());
        let long = dir.path().join("x".repeat(80));
        assert!(SshConfig::parse(CIPHERS).sharing(Some(long.clone())).is_empty() && !long.exists());
    }
}
