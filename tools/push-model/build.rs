//! Tells the tests whether an ssh server and ONNX Runtime are installed, so that those that need them are ignored instead of
//! passing without them.

const SSHD: &str = "/usr/sbin/sshd";
const ONNX_RUNTIME: &str = "ORT_DYLIB_PATH";

fn main() {
    println!("cargo::rustc-check-cfg=cfg(has_sshd)");
    println!("cargo::rustc-check-cfg=cfg(has_onnx_runtime)");
    // The folder, because a package installs a file with its own, older time.
    println!("cargo::rerun-if-changed=/usr/sbin");
    println!("cargo::rerun-if-env-changed={ONNX_RUNTIME}");
    if std::path::Path::new(SSHD).exists() {
        println!("cargo::rustc-cfg=has_sshd");
    }
    if std::env::var_os(ONNX_RUNTIME).is_some() {
        println!("cargo::rustc-cfg=has_onnx_runtime");
    }
}
