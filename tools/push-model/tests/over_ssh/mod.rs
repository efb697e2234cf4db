//! An ssh server on this computer, behind which the robot's program runs, and a key that it trusts.

use std::path::{Path, PathBuf};
use std::process::Command;

use hil::sshd::Sshd;
use tempfile::{TempDir, tempdir};

/// The workstation's program.
pub fn push_model() -> Command {
    Command::new(env!("CARGO_BIN_EXE_push-model"))
}

/// The robot's program, which is in the same directory as `push-model`.
pub fn firmware_host() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_push-model")).with_file_name("firmware-host");
    assert!(program.is_file(), "build it first: cargo build -p firmware-host");
    program
}

/// A network of the tests of `firmware-host`.
pub fn model(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware-host/tests/models");
    folder.join(format!("{name}.onnx"))
}

/// What a command prints, which must succeed.
pub fn stdout_of(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The ssh server, and a folder with `key` and `trusted_keys`.
pub struct Site {
    dir: TempDir,
    sshd: Sshd,
    library: String,
}

impl Site {
    /// Tests that call this are ignored without sshd and ONNX Runtime.
    pub fn new() -> Self {
        let library = std::env::var("ORT_DYLIB_PATH").expect("ORT_DYLIB_PATH is not set");
        let dir = tempdir().unwrap();
        let sshd = Sshd::start(&dir.path().join("ssh")).unwrap().expect("sshd cannot run here");
        let site = Self { dir, sshd, library };
        let key = stdout_of(push_model().args(["keygen", "--no-password"]).arg(site.path("key")));
        std::fs::write(site.path("trusted_keys"), key).unwrap();
        site
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The target of the store with this name.
    pub fn target(&self, store: &str) -> String {
        format!("127.0.0.1:{}", self.path(store).display())
    }

    /// `push-model` with the options that lead to this server and to the robot's program behind it.
    pub fn push(&self) -> Command {
        let firmware = format!("env ORT_DYLIB_PATH={} {}", self.library, firmware_host().display());
        let mut push = push_model();
        push.args(self.sshd.options().iter().map(|option| format!("--ssh={option}")));
        push.arg("--program").arg(firmware);
        push
    }
}
