//! A temporary ssh server on loopback with its own keys. Transfers between robot and workstation
//! are tested over the system's real OpenSSH.

use std::error::Error;
use std::fs::{self, Permissions};
use std::io;
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

use clap::Args;
use hal::Clock;
use monotonic_clock::MonotonicClock;

const SSHD: &str = "/usr/sbin/sshd";
const TRIES: u32 = 200;
const TRY_NS: u64 = 50_000_000;

/// A running ssh server. Dropping it ends the server.
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
    /// Starts a server with its keys and log in `dir`, on a free port. Returns `None` where there
    /// is no sshd or it cannot run, and prints the reason on standard error.
    ///
    /// # Errors
    /// Returns an error when the folder cannot be written or `ssh-keygen` fails.
    pub fn start(dir: &Path) -> io::Result<Option<Self>> {
        if !Path::new(SSHD).exists() {
            eprintln!("{SSHD} is not installed: apt-get install openssh-server");
            return Ok(None);
        }
        fs::create_dir_all(dir)?;
        fs::set_permissions(dir, Permissions::from_mode(0o700))?;
        for name in ["host_key", "key"] {
            let made = Command::new("ssh-keygen")
                .args(["-q", "-t", "ed25519", "-N", "", "-f"])
                .arg(dir.join(name))
                .status()?;
            if !made.success() {
                return Err(io::Error::other("ssh-keygen failed"));
            }
        }
        let home = dir.join("home");
        fs::create_dir_all(&home)?;
        // As root, sshd wants a directory that only root may write.
        let _ = fs::create_dir_all("/run/sshd");
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let config = format!(
            "Port {port}\nListenAddress 127.0.0.1\nHostKey {}\nAuthorizedKeysFile {}\nPidFile none\nUsePAM no\nStrictModes no\n\
             PasswordAuthentication no\nPermitRootLogin prohibit-password\nSetEnv HOME={}\n",
            dir.join("host_key").display(),
            dir.join("key.pub").display(),
            // An empty home folder keeps the user's shell start-up files out of the test and its
            // timing.
            home.display()
        );
        fs::write(dir.join("sshd_config"), config)?;
        let log = fs::File::create(dir.join("sshd.log"))?;
        let child = Command::new(SSHD)
            .args(["-D", "-e", "-f"])
            .arg(dir.join("sshd_config"))
            .stderr(log)
            .spawn()?;
        let mut server = Self { dir: dir.to_owned(), port, child };
        server.trust("host_key.pub")?;
        let mut clock = MonotonicClock;
        for _ in 0..TRIES {
            if TcpStream::connect(("127.0.0.1", port)).is_ok() {
                return Ok(Some(server));
            }
            if server.child.try_wait()?.is_some() {
                break;
            }
            let then_ns = clock.now_ns() + TRY_NS;
            clock.sleep_until_ns(then_ns);
        }
        eprintln!(
            "sshd could not be started: {}",
            fs::read_to_string(dir.join("sshd.log")).unwrap_or_default()
        );
        Ok(None)
    }

    /// Makes the workstation accept this public key, a file in the server's folder, as the robot's
    /// host key.
    ///
    /// # Errors
    /// Returns an error when there is no such file.
    pub fn trust(&self, public_key: &str) -> io::Result<()> {
        let key = fs::read_to_string(self.dir.join(public_key))?;
        fs::write(self.dir.join("known_hosts"), format!("[127.0.0.1]:{} {key}", self.port))
    }

    /// Folder with the server's keys and log.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Options with which `ssh 127.0.0.1` reaches this server.
    #[must_use]
    pub fn options(&self) -> Vec<String> {
        vec![
            format!("-p{}", self.port),
            "-F/dev/null".to_owned(),
            format!("-i{}", self.dir.join("key").display()),
            format!("-oUserKnownHostsFile={}", self.dir.join("known_hosts").display()),
            "-oStrictHostKeyChecking=yes".to_owned(),
            "-oIdentitiesOnly=yes".to_owned(),
            "-oBatchMode=yes".to_owned(),
            "-oLogLevel=ERROR".to_owned(),
        ]
    }
}

/// Arguments of `hil sshd`.
#[derive(Debug, Args)]
pub struct SshdArgs {
    /// Folder for the server's keys. Created if missing.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
}

/// Runs a server until it is killed. Prints the options for ssh on standard output, one per line.
///
/// # Errors
/// Returns an error when the server cannot be started.
pub fn run(args: &SshdArgs) -> Result<(), Box<dyn Error>> {
    let mut server = Sshd::start(&args.dir)?.ok_or("no ssh server can be started")?;
    println!("{}", server.options().join("\n"));
    server.child.wait()?;
    Ok(())
}
