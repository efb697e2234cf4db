//! What a person's configuration of ssh says about a host, and what is added to it: a connection that several calls share, and
//! the fastest of the allowed ciphers.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::SshOptions;

/// Takes an end's ssh 0.5 s of a processor for 1 GiB where there is hardware for it; OpenSSH's own first choice,
/// chacha20-poly1305, takes 1.4 s (measured, x86-64, OpenSSL 3.0).
const AES: &str = "aes128-gcm@openssh.com";

/// How long a shared connection waits for the next call, as in Ansible.
const PERSIST_S: u32 = 60;

/// Longest path of a socket, unix(7), less what ssh appends while it makes one.
const MAX_SOCKET: usize = 108 - 1 - 17;

/// Length of ssh's `%C`, a hash of who connects to whom.
const HASH: usize = 40;

/// The part of `ssh -G` that matters here.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SshConfig {
    ciphers: Vec<String>,
    /// It already says how connections are shared.
    shares: bool,
}

impl SshConfig {
    /// `None` when this ssh cannot say; nothing is added then.
    pub(super) fn read(host: &str, options: &SshOptions) -> Option<Self> {
        let mut ssh = Command::new(&options.program);
        ssh.arg("-G")
            .args(&options.arguments)
            .arg("--")
            .arg(host)
            .stdin(Stdio::null())
            .stderr(Stdio::null());
        let output = ssh.output().ok().filter(|output| output.status.success())?;
        Some(Self::parse(&String::from_utf8_lossy(&output.stdout)))
    }

    fn parse(text: &str) -> Self {
        let value =
            |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(' '));
        let ciphers = value("ciphers").unwrap_or_default().split(',').map(str::to_owned).collect();
        Self { ciphers, shares: value("controlpath").is_some() }
    }

    /// The allowed ciphers with AES in front; `None` when it is not allowed, or stands there already.
    pub(super) fn aes_first(&self) -> Option<String> {
        let at = self.ciphers.iter().position(|cipher| cipher == AES).filter(|at| *at > 0)?;
        let mut ciphers = self.ciphers.clone();
        let aes = ciphers.remove(at);
        ciphers.insert(0, aes);
        Some(format!("-oCiphers={}", ciphers.join(",")))
    }

    /// Options that make calls of this user share a connection for a minute; none where the configuration has its own way, or
    /// the system no folder for sockets.
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

/// A pattern for sockets in a folder of ours; `None` when it cannot be made, or its name is too long or means something to ssh.
fn socket_in(runtime_dir: &Path) -> Option<String> {
    let dir = runtime_dir.join("embodied-depth");
    let text = dir.to_str().filter(|text| {
        text.len() + 1 + HASH <= MAX_SOCKET && !text.contains(['%', '"', ' ', '$'])
    })?;
    // The folder above is the user's own and nobody else's, XDG Base Directory Specification.
    std::fs::create_dir_all(&dir).ok()?;
    Some(format!("{text}/%C"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CIPHERS: &str = "ciphers chacha20-poly1305@openssh.com,aes128-ctr,aes128-gcm@openssh.com,aes256-gcm@openssh.com";

    #[test]
    fn aes_goes_in_front_of_the_allowed_ciphers_and_none_is_added() {
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
    fn a_connection_is_shared_unless_the_configuration_has_its_own_way() {
        let dir = tempfile::tempdir().unwrap();
        let runtime_dir = || Some(dir.path().to_owned());
        let options = SshConfig::parse(CIPHERS).sharing(runtime_dir());
        assert!(
            options.contains(&format!("-oControlPath={}/embodied-depth/%C", dir.path().display())),
            "{options:?}"
        );
        assert!(dir.path().join("embodied-depth").is_dir());
        let own = SshConfig::parse("controlmaster auto\ncontrolpath /home/me/.ssh/x\n");
        assert!(own.sharing(runtime_dir()).is_empty());
        assert!(SshConfig::parse(CIPHERS).sharing(None).is_empty());
        let long = dir.path().join("x".repeat(80));
        assert!(SshConfig::parse(CIPHERS).sharing(Some(long.clone())).is_empty() && !long.exists());
    }
}
