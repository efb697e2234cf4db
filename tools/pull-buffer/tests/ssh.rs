//! The program `pull-buffer` over OpenSSH on loopback, with its own keys. Where sshd is not installed the tests are ignored.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

mod common;

use std::fs;
use std::path::Path;
use std::process::Command;

use common::{Server, SpiedSsh, assert_same, robot, stderr_of};
use segment_store::CpuFeatures;
use tempfile::tempdir;

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn a_robot_is_pulled_over_ssh_and_a_second_pull_transfers_nothing() {
    let server = Server::start();
    let robot = robot(3, 1 << 20);
    let here = tempdir().unwrap();
    let output = server.pull(robot.path(), here.path()).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", stderr_of(&output));
    assert_same(robot.path(), here.path(), 3);
    assert!(robot.path().join("run/recording_0002.mcap.pulled").exists());
    let output = server.pull(robot.path(), here.path()).arg("--json").output().unwrap();
    let last = String::from_utf8(output.stdout).unwrap().lines().last().unwrap().to_owned();
    let report: serde_json::Value = serde_json::from_str(&last).unwrap();
    assert_eq!(
        (&report["files"], &report["bytes"], &report["there"]),
        (&0.into(), &0.into(), &3.into()),
        "{report}"
    );
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn pulls_share_a_connection_that_the_users_ssh_keeps_open() {
    let server = Server::start();
    let robot = robot(2, 1 << 20);
    let here = tempdir().unwrap();
    let socket = server.sshd.dir().join("kept");
    let kept = [
        format!("-oControlPath={}", socket.display()),
        "-oControlMaster=auto".into(),
        "-oControlPersist=60".into(),
    ];
    for _ in 0..3 {
        let mut pull = server.pull(robot.path(), here.path());
        let output =
            pull.args(kept.iter().map(|option| format!("--ssh={option}"))).output().unwrap();
        assert!(output.status.success(), "{}", stderr_of(&output));
    }
    assert_same(robot.path(), here.path(), 2);
    let exit = Command::new("ssh")
        .args(server.sshd.options())
        .args(&kept)
        .args(["-O", "exit", "127.0.0.1"])
        .output();
    assert!(exit.unwrap().status.success(), "the connection is not there any more");
    assert_eq!(server.logins(), 1);
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn pulls_share_a_connection_without_any_configuration() {
    let server = Server::start();
    let robot = robot(1, 1 << 20);
    let here = tempdir().unwrap();
    let runtime_dir = tempdir().unwrap();
    for _ in 0..3 {
        let output = server
            .pull(robot.path(), here.path())
            .env("XDG_RUNTIME_DIR", runtime_dir.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", stderr_of(&output));
    }
    let path = format!("-oControlPath={}/embodied-depth/%C", runtime_dir.path().display());
    let exit = Command::new("ssh")
        .args(server.sshd.options())
        .args([&path, "-Oexit", "127.0.0.1"])
        .output();
    assert!(exit.unwrap().status.success(), "the connection is not there any more");
    assert_eq!(server.logins(), 1);
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn after_a_broken_link_the_next_connection_is_not_shared() {
    let server = Server::start();
    let robot = robot(1, 1 << 20);
    let here = tempdir().unwrap();
    let runtime_dir = tempdir().unwrap();
    let ssh = SpiedSsh::new();
    // A robot's side whose first answer is cut off.
    let script = here.path().join("serve");
    let serve = common::serving();
    let text = format!(
        "#!/bin/sh\nif mkdir {}/once 2>&-; then {1} \"$@\" | dd bs=4096 count=9 2>&-; else exec {1} \"$@\"; fi\n",
        here.path().display(),
        serve.display()
    );
    fs::write(&script, text).unwrap();
    let command = format!("sh {}", script.display());
    let mut pull = server.pull_with(Path::new(&command), robot.path(), here.path());
    let output =
        pull.env("PATH", ssh.path()).env("XDG_RUNTIME_DIR", runtime_dir.path()).output().unwrap();
    assert!(
        output.status.success() && stderr_of(&output).contains("trying again"),
        "{}",
        stderr_of(&output)
    );
    assert_same(robot.path(), here.path(), 1);
    let shared: Vec<_> = ssh.calls().iter().map(|call| call.contains("ControlPath")).collect();
    assert_eq!(shared, [true, false], "{:?}", ssh.calls());
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn aes_is_preferred_if_the_processor_has_it_unless_the_user_chose_a_cipher() {
    let server = Server::start();
    let robot = robot(1, 1 << 20);
    let here = tempdir().unwrap();
    let ssh = SpiedSsh::new();
    let output = server.pull(robot.path(), here.path()).env("PATH", ssh.path()).output().unwrap();
    assert!(output.status.success(), "{}", stderr_of(&output));
    let [call] = &ssh.calls()[..] else { panic!("{:?}", ssh.calls()) };
    assert_eq!(
        call.contains("-oCiphers=aes128-gcm@openssh.com,chacha20"),
        CpuFeatures::detect().aes,
        "{call}"
    );
    let only = "--ssh=-oCiphers=chacha20-poly1305@openssh.com";
    let output =
        server.pull(robot.path(), here.path()).arg(only).env("PATH", ssh.path()).output().unwrap();
    assert!(output.status.success(), "{}", stderr_of(&output));
    assert!(!ssh.calls()[1].contains("aes"), "{:?}", ssh.calls());
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn a_robot_without_aes_is_reconnected_with_sshs_choice_for_large_pulls() {
    let server = Server::start();
    // Where the local processor has no AES either, ssh's own choice is used from the start.
    let has_aes = CpuFeatures::detect().aes;
    for (bytes, calls) in [(1 << 20, 1), (65 << 20, if has_aes { 2 } else { 1 })] {
        let robot = robot(1, bytes);
        let here = tempdir().unwrap();
        let ssh = SpiedSsh::new();
        let without = format!("{} --without-aes", common::serving().display());
        let mut pull = server.pull_with(Path::new(&without), robot.path(), here.path());
        let output = pull.env("PATH", ssh.path()).output().unwrap();
        assert!(output.status.success(), "{}", stderr_of(&output));
        assert_same(robot.path(), here.path(), 1);
        assert_eq!(ssh.calls().len(), calls, "{:?}", ssh.calls());
        assert_eq!(
            ssh.calls().last().unwrap().contains("Ciphers"),
            has_aes && calls == 1,
            "{:?}",
            ssh.calls()
        );
    }
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn a_changed_host_key_is_refused_with_sshs_own_message() {
    let server = Server::start();
    let robot = robot(1, 1000);
    let here = tempdir().unwrap();
    server.sshd.trust("key.pub").unwrap();
    let output = server.pull(robot.path(), here.path()).output().unwrap();
    let text = stderr_of(&output);
    assert!(
        !output.status.success() && text.contains("REMOTE HOST IDENTIFICATION HAS CHANGED"),
        "{text}"
    );
    assert!(text.contains("ssh could not connect to 127.0.0.1") && text.contains("255"), "{text}");
    assert!(!here.path().join("robot/run").exists());
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn a_robot_without_the_program_is_an_error_with_a_way_out() {
    let server = Server::start();
    let robot = robot(1, 1000);
    let here = tempdir().unwrap();
    let output = server
        .pull_with(Path::new("/no/such/program"), robot.path(), here.path())
        .output()
        .unwrap();
    let text = stderr_of(&output);
    assert!(text.contains("/no/such/program") && text.contains("--program"), "{text}");
    assert_eq!(output.status.code(), Some(1));
}
