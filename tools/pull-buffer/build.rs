//! Tells the tests whether an ssh server is installed, so that those that need one are ignored instead of passing without it.

const SSHD: &str = "/usr/sbin/sshd";

fn main() {
    println!("cargo::rustc-check-cfg=cfg(has_sshd)");
    // The folder, because a package installs a file with its own, older time.
    println!("cargo::rerun-if-changed=/usr/sbin");
    if std::path::Path::new(SSHD).exists() {
        println!("cargo::rustc-cfg=has_sshd");
    }
}
