//! An ssh server of our own on loopback, with keys of its own.

use std::fs;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

use anyhow::{Context, Result, ensure};
use drivers::MonotonicClock;
use hal::Clock;

const SSHD: &str = "/usr/sbin/sshd";

/// Ends with its owner.
pub struct Sshd {
    dir: PathBuf,
    port: u16,
    child: Child,
}

impl Drop for Sshd {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Sshd {
    /// `None` where there is no sshd.
    ///
    /// # Errors
    /// When it does not start.
    pub fn start(dir: &Path) -> Result<Option<Self>> {
        if !Path::new(SSHD).exists() {
            return Ok(None);
        }
        fs::create_dir_all(dir)?;
        for name in ["host_key", "key"] {
            let made = Command::new("ssh-keygen")
                .args(["-q", "-t", "ed25519", "-N", "", "-f"])
                .arg(dir.join(name))
                .status()?;
            ensure!(made.success(), "ssh-keygen failed");
        }
        // As root, sshd wants a directory that only root may write.
        let _ = fs::create_dir_all("/run/sshd");
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let config = format!(
            "Port {port}\nListenAddress 127.0.0.1\nHostKey {}\nAuthorizedKeysFile {}\nPidFile none\nUsePAM no\nStrictModes no\n",
            dir.join("host_key").display(),
            dir.join("key.pub").display()
        );
        fs::write(dir.join("sshd_config"), config)?;
        let log = fs::File::create(dir.join("sshd.log"))?;
        let child = Command::new(SSHD).args(["-D", "-e", "-f"]).arg(dir.join("sshd_config")).stderr(log).spawn();
        let server = Self { dir: dir.to_owned(), port, child: child.context(SSHD)? };
        let mut clock = MonotonicClock;
        for _ in 0..200 {
            if TcpStream::connect(("127.0.0.1", port)).is_ok() {
                return Ok(Some(server));
            }
            let deadline_ns = clock.now_ns() + 25_000_000;
            clock.sleep_until_ns(deadline_ns);
        }
        let log = fs::read_to_string(dir.join("sshd.log")).unwrap_or_default();
        anyhow::bail!("sshd does not run: {log}")
    }

    fn options(&self) -> Vec<String> {
        vec![
            format!("-p{}", self.port),
            "-F/dev/null".to_owned(),
            format!("-i{}", self.dir.join("key").display()),
            "-oStrictHostKeyChecking=no".to_owned(),
            "-oUserKnownHostsFile=/dev/null".to_owned(),
            "-oIdentitiesOnly=yes".to_owned(),
            "-oBatchMode=yes".to_owned(),
            "-oLogLevel=ERROR".to_owned(),
        ]
    }

    /// `ssh` to it, up to the host.
    #[must_use]
    pub fn ssh(&self) -> Command {
        let mut command = Command::new("ssh");
        command.args(self.options()).arg("127.0.0.1");
        command
    }

    /// `rsync -a --checksum` from it.
    #[must_use]
    pub fn rsync(&self, from: &Path, to: &Path) -> Command {
        let mut command = Command::new("rsync");
        command.args(["-a", "--checksum", "-e", &format!("ssh {}", self.options().join(" "))]);
        command.arg(format!("127.0.0.1:{}/", from.display())).arg(format!("{}/", to.display()));
        command
    }

    /// `pull-buffer` from it.
    #[must_use]
    pub fn pull(&self, programs: &Path, from: &Path, to: &Path) -> Command {
        let mut command = Command::new(programs.join("pull-buffer"));
        command.arg(format!("127.0.0.1:{}", from.display())).arg(to);
        command.arg(format!("--remote-command={}", programs.join("firmware-host").display()));
        command.args(self.options().iter().map(|option| format!("--ssh-option={option}")));
        command.stderr(std::process::Stdio::null());
        command
    }
}
