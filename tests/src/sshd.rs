//! An ssh server of our own on loopback, with keys of its own: what travels between robot and workstation is tried over the
//! system's real OpenSSH.

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
    /// Starts it with its keys and log in `dir`, on a free port. `None` where there is no sshd, or it may not run here; said on
    /// standard error.
    ///
    /// # Errors
    /// When the folder cannot be written or `ssh-keygen` fails.
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
            // Else what this computer's user lets a shell do first is tried, and measured, as well.
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
            "sshd does not run here: {}",
            fs::read_to_string(dir.join("sshd.log")).unwrap_or_default()
        );
        Ok(None)
    }

    /// From now on the workstation knows the robot by this public key, a file in the server's folder.
    ///
    /// # Errors
    /// When there is none.
    pub fn trust(&self, public_key: &str) -> io::Result<()> {
        let key = fs::read_to_string(self.dir.join(public_key))?;
        fs::write(self.dir.join("known_hosts"), format!("[127.0.0.1]:{} {key}", self.port))
    }

    /// Its keys and its log.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Options with which `ssh 127.0.0.1` reaches it.
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
    /// Folder for its keys. Made if missing.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
}

/// Runs one until it is killed; the options for ssh go to standard output, one a line.
///
/// # Errors
/// When it cannot be started.
pub fn run(args: &SshdArgs) -> Result<(), Box<dyn Error>> {
    let mut server = Sshd::start(&args.dir)?.ok_or("there is no ssh server to start")?;
    println!("{}", server.options().join("\n"));
    server.child.wait()?;
    Ok(())
}
