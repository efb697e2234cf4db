//! The real thing: `pull-buffer` over OpenSSH on loopback, with keys of its own. Without an sshd the tests say so and pass.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test that cannot set up its files has failed")]

mod common;

use std::fs;
use std::path::Path;
use std::process::Command;

use common::{Server, SpiedSsh, assert_same, robot, words};
use segment_store::CpuFeatures;
use tempfile::tempdir;

#[test]
fn a_robot_is_pulled_over_ssh_and_a_second_pull_transfers_nothing() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(3, 1 << 20), tempdir().unwrap());
    let output = server.pull(robot.path(), here.path()).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", words(&output));
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
fn pulls_share_a_connection_that_the_users_ssh_keeps_open() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(2, 1 << 20), tempdir().unwrap());
    let socket = server.sshd.dir().join("kept");
    let kept = [
        format!("-oControlPath={}", socket.display()),
        "-oControlMaster=auto".into(),
        "-oControlPersist=60".into(),
    ];
    for _ in 0..3 {
        let mut pull = server.pull(robot.path(), here.path());
        let output =
            pull.args(kept.iter().map(|option| format!("--ssh-option={option}"))).output().unwrap();
        assert!(output.status.success(), "{}", words(&output));
    }
    assert_same(robot.path(), here.path(), 2);
    let exit = Command::new("ssh")
        .args(server.sshd.options())
        .args(&kept)
        .args(["-O", "exit", "127.0.0.1"])
        .output();
    assert!(exit.unwrap().status.success(), "the connection is not there any more");
    assert_eq!(server.greetings(), 1);
}

#[test]
fn pulls_share_a_connection_without_any_configuration() {
    let Some(server) = Server::start() else { return };
    let (robot, here, runtime_dir) = (robot(1, 1 << 20), tempdir().unwrap(), tempdir().unwrap());
    for _ in 0..3 {
        let output = server
            .pull(robot.path(), here.path())
            .env("XDG_RUNTIME_DIR", runtime_dir.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", words(&output));
    }
    let path = format!("-oControlPath={}/embodied-depth/%C", runtime_dir.path().display());
    let exit = Command::new("ssh")
        .args(server.sshd.options())
        .args([&path, "-Oexit", "127.0.0.1"])
        .output();
    assert!(exit.unwrap().status.success(), "the connection is not there any more");
    assert_eq!(server.greetings(), 1);
}

#[test]
fn after_a_broken_link_the_next_connection_is_not_shared() {
    let Some(server) = Server::start() else { return };
    let (robot, here, runtime_dir, ssh) =
        (robot(1, 1 << 20), tempdir().unwrap(), tempdir().unwrap(), SpiedSsh::new());
    // The first time its end is missing.
    let (script, serve) = (here.path().join("serve"), common::serving());
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
        output.status.success() && words(&output).contains("trying again"),
        "{}",
        words(&output)
    );
    assert_same(robot.path(), here.path(), 1);
    let shared: Vec<_> = ssh.calls().iter().map(|call| call.contains("ControlPath")).collect();
    assert_eq!(shared, [true, false], "{:?}", ssh.calls());
}

#[test]
fn aes_is_preferred_if_the_processor_has_it_unless_the_user_chose_a_cipher() {
    let Some(server) = Server::start() else { return };
    let (robot, here, ssh) = (robot(1, 1 << 20), tempdir().unwrap(), SpiedSsh::new());
    let output = server.pull(robot.path(), here.path()).env("PATH", ssh.path()).output().unwrap();
    assert!(output.status.success(), "{}", words(&output));
    let [call] = &ssh.calls()[..] else { panic!("{:?}", ssh.calls()) };
    assert_eq!(
        call.contains("-oCiphers=aes128-gcm@openssh.com,chacha20"),
        CpuFeatures::detect().aes,
        "{call}"
    );
    let only = "--ssh-option=-oCiphers=chacha20-poly1305@openssh.com";
    let output =
        server.pull(robot.path(), here.path()).arg(only).env("PATH", ssh.path()).output().unwrap();
    assert!(output.status.success(), "{}", words(&output));
    assert!(!ssh.calls()[1].contains("aes"), "{:?}", ssh.calls());
}

#[test]
fn a_robot_without_aes_is_reconnected_with_sshs_choice_for_large_pulls() {
    let Some(server) = Server::start() else { return };
    if !CpuFeatures::detect().aes {
        return;
    }
    for (bytes, calls) in [(1 << 20, 1), (65 << 20, 2)] {
        let (robot, here, ssh) = (robot(1, bytes), tempdir().unwrap(), SpiedSsh::new());
        let without = format!("{} --without-aes", common::serving().display());
        let mut pull = server.pull_with(Path::new(&without), robot.path(), here.path());
        let output = pull.env("PATH", ssh.path()).output().unwrap();
        assert!(output.status.success(), "{}", words(&output));
        assert_same(robot.path(), here.path(), 1);
        assert_eq!(ssh.calls().len(), calls, "{:?}", ssh.calls());
        assert_eq!(
            ssh.calls().last().unwrap().contains("Ciphers"),
            calls == 1,
            "{:?}",
            ssh.calls()
        );
    }
}

#[test]
fn a_changed_host_key_is_refused_with_sshs_own_message() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(1, 1000), tempdir().unwrap());
    server.sshd.trust("key.pub").unwrap();
    let output = server.pull(robot.path(), here.path()).output().unwrap();
    let words = words(&output);
    assert!(
        !output.status.success() && words.contains("REMOTE HOST IDENTIFICATION HAS CHANGED"),
        "{words}"
    );
    assert!(
        words.contains("ssh did not get through to 127.0.0.1") && words.contains("255"),
        "{words}"
    );
    assert!(!here.path().join("robot/run").exists());
}

#[test]
fn a_robot_without_the_program_is_an_error_with_a_way_out() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(1, 1000), tempdir().unwrap());
    let output = server
        .pull_with(Path::new("/no/such/program"), robot.path(), here.path())
        .output()
        .unwrap();
    let words = words(&output);
    assert!(words.contains("/no/such/program") && words.contains("--remote-command"), "{words}");
    assert_eq!(output.status.code(), Some(1));
}
