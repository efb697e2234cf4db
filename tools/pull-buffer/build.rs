//! Tells the tests whether an ssh server is installed, so that those that need one are ignored instead of passing without it.

const SSHD: &str = "/usr/sbin/sshd";

fn main() {
    println!("cargo::rustc-check-cfg=cfg(has_sshd)");
    println!("cargo::rerun-if-changed={SSHD}");
    if std::path::Path::new(SSHD).exists() {
        println!("cargo::rustc-cfg=has_sshd");
    }
}
