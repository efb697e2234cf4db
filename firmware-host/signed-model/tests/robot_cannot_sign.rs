//! The robot's program only verifies signatures; nothing that signs may come into it again.
#![allow(clippy::unwrap_used, reason = "a test that cannot run cargo has failed")]

use std::process::Command;

/// Names of all packages that a normal build of `package` contains.
fn dependencies_of(package: &str, more: &[&str]) -> Vec<String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["tree", "--offline", "--locked", "--edges=normal", "--prefix=none"])
        .args(["--format={lib} {p}", "--package", package])
        .args(more)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
}

#[test]
fn the_robots_program_contains_neither_minisigns_signer_nor_scrypt() {
    for more in [&[][..], &["--all-features"]] {
        let dependencies = dependencies_of("firmware-host", more);
        assert!(dependencies.iter().any(|name| name == "minisign_verify"), "{dependencies:?}");
        for signer in ["minisign", "scrypt"] {
            assert!(
                !dependencies.iter().any(|name| name == signer),
                "{signer} is linked: {more:?}"
            );
        }
    }
}

#[test]
fn the_workstations_program_contains_minisigns_signer() {
    assert!(dependencies_of("push-model", &[]).iter().any(|name| name == "minisign"));
}
