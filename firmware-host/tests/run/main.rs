//! The whole binary on simulated devices, in real time and through the real drivers: what it promises when devices come and go.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

mod imu;
mod lost;
mod models;
mod roll_out;
mod scene;

use std::io::{Read, Write};
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use assert_cmd::cargo::CommandCargoExt;
use drivers::can::Protocol;
use drivers::rplidar::Model;
use firmware_host::recorded::Recorded;
use firmware_host::run::status::Status;
use hal::{CameraModel, Clock};
use hil::motor::wheel::COAST_S;
use hil::world::{LiveOptions, LiveWorld, ScannerModel};
use live_link::{Frame, FrameReader};
use monotonic_clock::MonotonicClock;
use runtime::outside_pose::OutsidePose;
use runtime::task::AreaChange;
use rustix::process::{Pid, Signal, kill_process};
use scene::{PATIENCE, Scene, pause, replayed, start};

#[test]
fn a_second_program_for_the_same_base_is_refused_and_the_first_drives_on() {
    let mut scene = Scene::new(Protocol::Odrive);
    scene.drives_first();
    // Without --out, in a folder of its own: nothing may be made there.
    let elsewhere = tempfile::tempdir().unwrap();
    let second = Command::cargo_bin("firmware-host")
        .unwrap()
        .args(["run", "--config"])
        .arg(scene.world.config())
        .current_dir(elsewhere.path())
        .output()
        .unwrap();
    let said = String::from_utf8(second.stderr).unwrap();
    assert!(
        second.status.code() == Some(1)
            && said.contains("another `firmware-host run` drives the base"),
        "{said}"
    );
    assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 0);
    scene.drives("driving on");
    scene.ends_well();
}

#[test]
fn it_explores_stands_while_a_device_is_gone_says_so_and_goes_on_without_help() {
    let mut scene = Scene::new(Protocol::Odrive);
    scene.drives_first();

    scene.world.lidar().unplug();
    scene.state_is("fault: no new scan from the LiDAR");
    assert!(scene.driven_m() < 0.01, "it drives without a scanner");
    let (well, text) = scene.health();
    assert!(!well && text.contains("! LiDAR") && text.contains("continues on its own"), "{text}");
    scene.world.lidar().plug_in().unwrap();
    scene.drives("driving after the scanner was plugged in again");

    scene.world.plug_camera(false);
    scene.wait("a camera that is gone", |scene| {
        scene.status().is_some_and(|status| status.camera.state != "working")
    });
    pause(2000);
    assert!(scene.driven_m() < 0.01, "it drives blindly");
    scene.world.plug_camera(true);
    scene.drives("driving after the camera was plugged in again");
    scene.ends_well();
}

/// It drives, stands while the scanner is gone or rotates too slowly, and goes on.
fn drives_and_stands_rightly_with(lidar: ScannerModel, fault_of_the_motor: &str) {
    let options = LiveOptions {
        lidar,
        camera: CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2),
        ..LiveOptions::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let world = LiveWorld::start(folder.path(), &options).unwrap();
    let robot = start(&world, folder.path(), "run", &[]);
    let mut scene = Scene { folder, world, robot };
    scene.drives_first();
    scene.world.lidar().unplug();
    scene.state_is("fault: no new scan from the LiDAR");
    assert!(scene.driven_m() < 0.01, "it drives without a scanner");
    scene.world.lidar().plug_in().unwrap();
    scene.drives("driving after the scanner was plugged in again");
    scene.world.lidar().break_motor(true);
    scene.wait("a fault of the scanner", |scene| {
        let problem = scene.status().and_then(|status| status.lidar.problem);
        problem.is_some_and(|problem| problem.contains(fault_of_the_motor))
    });
    scene.state_is("fault: no new scan from the LiDAR");
    assert!(scene.driven_m() < 0.01, "it drives with a broken scanner");
    scene.world.lidar().break_motor(false);
    scene.drives("driving after the scanner was repaired");
    let (touches, _) = scene.world.home().score();
    assert_eq!(touches, 0);
    scene.ends_well();
}

#[test]
fn with_an_ld06_it_drives_stands_while_the_scanner_is_gone_or_slow_and_goes_on() {
    drives_and_stands_rightly_with(ScannerModel::Ld06, "rotates 3.");
}

#[test]
fn with_an_rplidar_a1_it_drives_stands_while_the_scanner_is_gone_or_broken_and_goes_on() {
    drives_and_stands_rightly_with(ScannerModel::Rplidar(Model::A1), "code 0x8002");
}

#[test]
fn a_motor_that_broke_down_needs_a_person_and_sigusr1_is_that_person() {
    let mut scene = Scene::new(Protocol::Cia402);
    scene.drives_first();
    scene.world.wheels()[1].faults().broken = true;
    scene.wait("a fault", |scene| scene.status().is_some_and(|status| status.safety.needs_person));
    assert!(scene.driven_m() < 0.01);
    assert!(scene.health().1.contains("kill -USR1"));
    scene.world.wheels()[1].faults().broken = false;
    assert!(scene.driven_m() < 0.01, "it drives before it is armed again");
    let (_, before_m) = scene.world.home().score();
    scene.wait("driving after SIGUSR1", |scene| {
        scene.signal(Signal::USR1);
        pause(500);
        scene.world.home().score().1 > before_m + 0.1
    });
    scene.signal(Signal::USR2);
    scene.state_is("fault: the emergency stop is pressed");
    assert!(scene.driven_m() < 0.05, "it brakes within centimetres");
    scene.ends_well();
}

#[test]
fn an_order_over_the_live_view_stops_the_robot_until_another_one_arms_it() {
    let mut scene = Scene::with(Protocol::Odrive, "\n[live]\nsocket = \"{}/live.sock\"\n", &[]);
    scene.drives_first();
    order(&scene, "stop");
    scene.state_is("fault: the emergency stop is pressed");
    assert!(scene.driven_m() < 0.05, "it brakes within centimetres");
    let (_, before_m) = scene.world.home().score();
    scene.wait("driving after the order to arm", |scene| {
        order(scene, "arm");
        pause(2000);
        scene.world.home().score().1 > before_m + 0.1
    });
    scene.ends_well();
}

fn order(scene: &Scene, order: &str) {
    let mut socket = UnixStream::connect(scene.path("live.sock")).unwrap();
    let line = format!(
        "{{\"order\":{{\"id\":1,\"who\":\"the test\",\"role\":\"steer\",\"order\":{{\"order\":\"{order}\"}}}}}}\n"
    );
    socket.write_all(line.as_bytes()).unwrap();
    let mut reader = FrameReader::default();
    loop {
        let mut piece = [0; 4096];
        let count = socket.read(&mut piece).unwrap();
        reader.push(&piece[..count]);
        while let Some(frame) = reader.next_frame().unwrap() {
            if let Frame::Answer(answer) = frame {
                assert!(answer.accepted, "{answer:?}");
                return;
            }
        }
    }
}

#[test]
fn motor_power_that_is_cut_and_restored_moves_nothing_before_sigusr1() {
    for protocol in [Protocol::Odrive, Protocol::Vesc, Protocol::Cia402] {
        let mut scene = Scene::new(protocol);
        scene.drives_first();
        for node in scene.world.wheels().iter_mut() {
            node.faults().boot_ns = 300_000_000;
            node.faults().unpowered = true;
        }
        scene.needs_person("the robot needs a person");
        pause(1000);
        scene.world.wheels().iter_mut().for_each(|node| node.faults().unpowered = false);
        scene.stands_until_armed();
        scene.ends_well();
    }
}

#[test]
fn a_usb_hub_that_resets_all_devices_at_once_stops_the_robot_until_a_person_arms_it() {
    for protocol in [Protocol::Odrive, Protocol::Vesc, Protocol::Cia402] {
        let mut scene = Scene::new(protocol);
        scene.drives_first();
        scene.world.power_usb_hub(false).unwrap();
        scene.needs_person("the base cannot be driven");
        scene.wait("all three devices gone", |scene| {
            let text = scene.health().1;
            ["! camera", "! LiDAR", "! base"].iter().all(|device| text.contains(device))
        });
        pause(2000);
        assert!(scene.driven_m() < 0.01, "{protocol:?}: it drives without any device");
        scene.world.power_usb_hub(true).unwrap();
        scene.wait("all three devices back", |scene| {
            scene.status().is_some_and(|status| {
                [&status.camera, &status.lidar].iter().all(|device| device.state == "working")
                    && status.base.reopened > 0
            })
        });
        scene.stands_until_armed();
        scene.ends_well();
    }
}

#[test]
fn the_safety_boards_emergency_stop_wins_and_survives_a_restart_of_the_program() {
    let (mut scene, board) = Scene::with_board(false);
    scene.drives_first();
    board.press(true);
    scene.needs_person("emergency stop");
    assert!(scene.driven_m() < 0.01);
    scene.signal(Signal::USR1);
    assert!(scene.driven_m() < 0.01, "a pressed stop cannot be overruled");
    board.press(false);
    // The configuration says `arm_at_start`.
    scene.restart("second");
    scene.needs_person("emergency stop");
    scene.stands_until_armed();
    // Armed by a person, the next program may arm on its own again.
    scene.restart("third");
    scene.drives("driving after an ordinary restart");
}

#[test]
fn an_emergency_stop_that_is_pressed_while_the_scanner_is_silent_wins() {
    let (mut scene, board) = Scene::with_board(false);
    scene.drives_first();
    scene.world.lidar().unplug();
    scene.state_is("fault: no new scan from the LiDAR");
    board.press(true);
    scene.needs_person("emergency stop");
    scene.world.lidar().plug_in().unwrap();
    scene.wait("a scanner that works again", |scene| {
        scene.status().is_some_and(|status| status.lidar.state == "working")
    });
    board.press(false);
    scene.stands_until_armed();
    scene.ends_well();
}

#[test]
fn an_emergency_stop_that_is_pressed_at_power_on_moves_nothing_when_it_is_released() {
    // The configuration says `arm_at_start`.
    let (mut scene, board) = Scene::with_board(true);
    scene.needs_person("emergency stop");
    board.press(false);
    scene.stands_until_armed();
    scene.ends_well();
}

#[test]
fn a_safety_board_that_is_unplugged_stops_the_robot_and_moves_nothing_when_it_is_back() {
    let (mut scene, board) = Scene::with_board(false);
    scene.drives_first();
    board.plug(false);
    scene.needs_person("no message from the safety board");
    assert!(scene.driven_m() < 0.01, "it drives without its board");
    board.plug(true);
    scene.stands_until_armed();
    scene.ends_well();
}

#[test]
fn a_cliff_that_the_safety_board_reports_again_and_again_needs_a_person() {
    let (mut scene, board) = Scene::with_board(false);
    scene.drives_first();
    board.put_before_cliff(true);
    scene.needs_person("three contacts at one place");
    board.put_before_cliff(false);
    scene.stands_until_armed();
    scene.ends_well();
}

#[test]
fn an_emergency_stop_on_an_input_line_wins_and_its_release_moves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let line = folder.path().join("line");
    set_level(&line, "0");
    let more = format!("\n[devices.emergency_stop]\nchip = \"file:{}\"\n", line.display());
    let mut scene = Scene::with(Protocol::Odrive, &more, &[]);
    scene.drives_first();
    set_level(&line, "1");
    scene.needs_person("emergency stop");
    assert!(scene.driven_m() < 0.01 && scene.health().1.contains("pressed, or its wire is broken"));
    scene.signal(Signal::USR1);
    assert!(scene.driven_m() < 0.01, "a pressed stop cannot be overruled");
    set_level(&line, "0");
    scene.stands_until_armed();
    std::fs::remove_file(&line).unwrap();
    scene.needs_person("must contain 0 or 1");
    set_level(&line, "0");
    scene.stands_until_armed();
    scene.ends_well();
}

/// In one step, because the robot reads the file all the time.
fn set_level(line: &Path, level: &str) {
    std::fs::write(line.with_extension("new"), level).unwrap();
    std::fs::rename(line.with_extension("new"), line).unwrap();
}

#[test]
fn check_drive_measures_a_robot_in_a_home_and_leaves_its_motors_idle() {
    let folder = tempfile::tempdir().unwrap();
    let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
    let options = LiveOptions { camera, ..LiveOptions::default() };
    let world = LiveWorld::start(folder.path(), &options).unwrap();
    let measured = folder.path().join("commissioning.toml");
    let began = Instant::now();
    // A busy computer delays the simulated motors, which then count as silent.
    while !measured.exists() {
        let mut check = Command::cargo_bin("firmware-host").unwrap();
        check.args(["check", "--drive", "--yes", "--config"]).arg(world.config());
        let output = check.output().unwrap();
        let said = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        assert!(began.elapsed() < PATIENCE, "never measured: {}", said.concat());
        if measured.exists() {
            for what in ["reaction time", "braking distance", "roll-out", "yaw of the LiDAR"] {
                assert!(said[0].contains(what), "{}", said[0]);
            }
        }
    }
    let written: toml::Table = std::fs::read_to_string(measured).unwrap().parse().unwrap();
    assert!((0.01..0.2).contains(&number(&written, "braking_m")), "{written}");
    // An ODrive's wheels coast when the commands end: at least as far as their speed takes them in their time constant.
    let coasted_m = 0.8 * COAST_S * number(&written, "roll_out_speed_mps");
    assert!((coasted_m..0.3).contains(&number(&written, "roll_out_m")), "{written}");
    assert!(written["worse"].to_string().contains("roll-out"), "it rolls too far: {written}");
    assert!(number(&written, "lidar_yaw_deg").abs() < 5.0, "{written}");
    assert!(world.wheels().iter().all(|node| !node.is_powered()), "the motors are released");
    assert_eq!(world.home().score().0, 0, "it touched something");
}

#[test]
fn calibrate_drive_drives_on_a_small_floor_without_a_touch_and_writes_what_it_measured() {
    let folder = tempfile::tempdir().unwrap();
    let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
    let options = LiveOptions { camera, ..LiveOptions::default() };
    let world = LiveWorld::start(folder.path(), &options).unwrap();
    let run = folder.path().join("calibration-drive");
    let mut calibrate = Command::cargo_bin("firmware-host").unwrap();
    calibrate.args(["calibrate", "--drive", "--yes", "--seconds", "60", "--run-out"]).arg(&run);
    let output = calibrate.arg("--config").arg(world.config()).output().unwrap();
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(output.status.success(), "{}", said.concat());
    assert_eq!(world.home().score().0, 0, "it touched something");
    let written = std::fs::read_to_string(folder.path().join("calibration.toml")).unwrap();
    let written: toml::Table = written.parse().unwrap();
    let track_m = written["devices"]["base"]["track_m"].as_float().unwrap();
    assert!((0.23..0.25).contains(&track_m), "{written}");
    let yaw_deg = written["lidar"]["yaw_deg"].as_float().unwrap();
    assert!(yaw_deg.abs() < 1.0, "{written}");
    let (is_equal, text) = replayed(&run, &[]);
    assert!(is_equal, "{text}");
}

fn number(table: &toml::Table, key: &str) -> f64 {
    table[key].as_float().unwrap()
}

#[test]
fn a_program_that_was_stopped_for_three_seconds_stands_when_it_continues() {
    let scene = Scene::new(Protocol::Odrive);
    scene.drives_first();
    scene.signal(Signal::STOP);
    pause(3000);
    scene.signal(Signal::CONT);
    scene.needs_person("the program was paused");
    scene.stands_until_armed();
}

#[test]
fn while_the_planner_hangs_the_robot_stands_sigusr2_stops_it_and_sigterm_releases_the_motors() {
    // Each tick of the exploration loop comes 4 s late.
    let mut scene =
        Scene::with(Protocol::Odrive, "", &["--fault", "clock:slow=4000@8..600", "--no-recording"]);
    scene.drives_first();
    scene.wait("a hanging planner", |scene| {
        scene.status().is_some_and(|status| status.uptime_s > 8.0)
    });
    pause(3000);
    // A plan may be 0.5 s old, so the robot drives for less than that of each four seconds.
    let (_, before_m) = scene.world.home().score();
    pause(8000);
    let gone_m = scene.world.home().score().1 - before_m;
    assert!(gone_m < 0.5, "{gone_m} m in 8 s without a planner");
    scene.signal(Signal::USR2);
    pause(500);
    let (_, before_m) = scene.world.home().score();
    pause(5000);
    let gone_m = scene.world.home().score().1 - before_m;
    assert!(gone_m < 0.02, "{gone_m} m after an emergency stop");
    scene.state_is("fault: the emergency stop is pressed");
    scene.signal(Signal::TERM);
    pause(1500);
    let wheels = scene.world.wheels();
    assert!(wheels.iter().all(|node| !node.is_powered()), "the motors wait for the planner");
    drop(wheels);
    assert!(scene.robot.wait().unwrap().success());
}

#[test]
fn dirt_before_the_scanner_stops_the_robot_until_it_is_gone() {
    let mut scene = Scene::with(Protocol::Odrive, "", &["--fault", "lidar:dirt=67@8..20"]);
    scene.drives_first();
    scene.wait("dirt", |scene| scene.status().is_some_and(|status| status.uptime_s > 9.0));
    let (_, before_m) = scene.world.home().score();
    pause(4000);
    let gone_m = scene.world.home().score().1 - before_m;
    assert!(gone_m < 0.02, "{gone_m} m in 4 s behind dirt");
    scene.drives("driving after the dirt was wiped off");
    scene.ends_well();
}

#[test]
fn sigterm_and_sighup_leave_the_motors_idle_and_not_in_a_fault_of_their_watchdogs() {
    for (protocol, signal) in [(Protocol::Odrive, Signal::TERM), (Protocol::Cia402, Signal::HUP)] {
        let mut scene = Scene::new(protocol);
        scene.drives_first();
        scene.signal(signal);
        assert!(scene.robot.wait().unwrap().success());
        pause(500);
        for node in scene.world.wheels().iter() {
            assert!(!node.is_powered() && node.watchdog().expired == 0, "{protocol:?}");
        }
    }
}

#[test]
fn a_run_that_has_its_number_of_frames_leaves_the_motors_idle() {
    let mut scene = Scene::with(Protocol::Odrive, "", &["--frames", "120", "--no-recording"]);
    scene.drives_first();
    assert!(scene.robot.wait().unwrap().success());
    pause(500);
    for node in scene.world.wheels().iter() {
        assert!(!node.is_powered() && node.watchdog().expired == 0);
    }
}

#[test]
fn killed_in_the_middle_the_wheels_stand_and_the_recording_replays() {
    let mut scene = Scene::new(Protocol::Vesc);
    scene.drives_first();
    scene.drives("some more");
    scene.signal(Signal::KILL);
    scene.robot.wait().unwrap();
    // The controllers' watchdogs: 100 ms, and the wheels' own lag.
    pause(400);
    assert!(scene.world.wheels().iter().all(|node| node.wheel().velocity_radps().abs() < 0.1));
    let (_, text) = replayed(&scene.folder.path().join("run"), &[]);
    assert!(text.contains("mismatches=0") && text.contains("truncated after tick"), "{text}");
    pause(3000);
    let (well, text) = scene.health();
    assert!(!well && text.contains("the program (pid"), "{text}");
}

/// Waits until the robot has run for this long, seconds.
fn runs_for(folder: &Path, seconds: f64) {
    let began = Instant::now();
    while Status::read(&folder.join("status.json")).map_or(0.0, |status| status.uptime_s) < seconds
    {
        assert!(began.elapsed() < PATIENCE, "it does not run");
        pause(20);
    }
}

/// A robot none of whose devices is there.
fn without_devices(folder: &Path) -> Command {
    let config = format!(
        "[run]\nstatus_file = \"{0}/status.json\"\ntask_file = \"{0}/task.json\"\nstop_file = \"{0}/stop.json\"\n\
         [devices.camera]\ndevice = \"{0}/camera\"\n[devices.lidar]\nport = \"{0}/lidar\"\n\
         [devices.base]\nbus = \"unix:{0}/can\"\nprotocol = \"vesc\"\n",
        folder.display()
    );
    std::fs::write(folder.join("robot.toml"), config).unwrap();
    let mut run = Command::cargo_bin("firmware-host").unwrap();
    run.args(["run", "--config"])
        .arg(folder.join("robot.toml"))
        .arg("--out")
        .arg(folder.join("run"));
    run
}

fn ends(mut robot: Child) -> std::process::Output {
    kill_process(Pid::from_raw(robot.id() as i32).unwrap(), Signal::TERM).unwrap();
    assert!(robot.wait().unwrap().success());
    robot.wait_with_output().unwrap()
}

#[test]
fn a_robot_without_devices_says_which_are_missing_and_names_no_map_that_it_has_not_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = without_devices(folder.path());
    let robot = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    runs_for(folder.path(), 3.0);
    let output = ends(robot);
    let said = String::from_utf8_lossy(&output.stderr);
    for device in ["camera", "LiDAR", "base"] {
        let report = format!("supervision: {device} ");
        assert_eq!(said.matches(&report).count(), 1, "{device}: {said}");
    }
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("has mapped nothing") && !said.contains("map.png"), "{said}");
    assert!(!folder.path().join("run/map.png").exists());
}

#[test]
fn a_robot_whose_closed_areas_cannot_be_read_does_not_run() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = without_devices(folder.path());
    let missing = folder.path().join("areas.json");
    let output = run.arg("--keep-out").arg(&missing).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("areas.json"), "{said}");
    assert!(!folder.path().join("run").exists());
}

#[test]
fn a_robot_that_has_to_be_measured_first_does_not_run_without_its_measurement() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = without_devices(folder.path());
    let config = std::fs::read_to_string(folder.path().join("robot.toml")).unwrap();
    let config = config.replace("[run]\n", "[run]\ncommissioning = \"measured\"\n");
    std::fs::write(folder.path().join("robot.toml"), config).unwrap();
    let output = run.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("commissioning"), "{said}");
    assert!(!folder.path().join("run").exists());
}

#[test]
fn areas_that_were_drawn_on_a_map_are_closed_when_a_run_begins_with_that_map() {
    let areas = br#"{"type":"Polygon","coordinates":[[[1,0],[2,0],[2,1],[1,1],[1,0]]]}"#;
    let file = Some(("home.map.keep-out.geojson", &areas[..]));
    let args = ["--map", "{}/home.map", "--frames", "10"];
    let mut scene = Scene::with_file(Protocol::Vesc, "", &args, file);
    assert!(scene.robot.wait().unwrap().success());
    let first = Recorded::open(&scene.path("run")).unwrap().ticks().next().unwrap().unwrap();
    let corners_m = [[1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]];
    assert_eq!(first.areas, [AreaChange::Close { corners_m }]);
}

#[test]
fn the_map_of_another_scanner_ends_the_run_with_words_and_stays_as_it_is() {
    let args = ["--map", "{}/home.map", "--frames", "30"];
    let mut first = Scene::with(Protocol::Vesc, "", &args);
    assert!(first.robot.wait().unwrap().success());
    let map = std::fs::read(first.path("home.map")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("home.map"), &map).unwrap();
    let camera = CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2);
    let lidar = ScannerModel::Rplidar(Model::A1);
    let options = LiveOptions { camera, lidar, ..LiveOptions::default() };
    let world = LiveWorld::start(folder.path(), &options).unwrap();
    let mut run = Command::cargo_bin("firmware-host").unwrap();
    run.args(["run", "--frames", "100", "--config"]).arg(world.config());
    run.arg("--out").arg(folder.path().join("run"));
    let output = run.arg("--map").arg(folder.path().join("home.map")).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("was made with another scanner"), "{said}");
    assert_eq!(std::fs::read(folder.path().join("home.map")).unwrap(), map);
}

#[test]
fn a_robot_whose_terminal_was_closed_goes_on_and_ends_with_its_summary() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = without_devices(folder.path());
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let robot = run.stdout(writer.try_clone().unwrap()).stderr(writer).spawn().unwrap();
    runs_for(folder.path(), 3.0);
    ends(robot);
    assert!(folder.path().join("run/summary.json").exists());
}

#[test]
fn a_robot_that_was_started_by_nohup_goes_on_without_its_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let run = without_devices(folder.path());
    let mut nohup = Command::new("sh");
    nohup
        .args(["-c", "trap '' HUP; exec \"$@\"", "sh"])
        .arg(run.get_program())
        .args(run.get_args());
    let robot = nohup.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    runs_for(folder.path(), 1.0);
    kill_process(Pid::from_raw(robot.id() as i32).unwrap(), Signal::HUP).unwrap();
    runs_for(folder.path(), 3.0);
    ends(robot);
}

#[test]
fn a_robot_signs_its_runs_and_a_workstation_accepts_those_of_the_robots_that_it_knows() {
    let folder = tempfile::tempdir().unwrap();
    without_devices(folder.path());
    let key = folder.path().join("state/identity.key");
    let identity = format!("[identity]\nkey_file = \"{}\"\nname = \"kitchen\"\n", key.display());
    let config = std::fs::read_to_string(folder.path().join("robot.toml")).unwrap() + &identity;
    std::fs::write(folder.path().join("robot.toml"), config).unwrap();
    for _ in 0..2 {
        let mut run = program(&["run", "--config"]);
        let robot =
            run.arg(folder.path().join("robot.toml")).arg("--runs").arg(folder.path().join("runs"));
        let robot = robot.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        runs_for(folder.path(), 1.0);
        ends(robot);
    }
    let known =
        program(&["identity", "--config"]).arg(folder.path().join("robot.toml")).output().unwrap();
    std::fs::write(folder.path().join("robots"), known.stdout).unwrap();
    std::fs::write(folder.path().join("others"), format!("{} hall\n", "cd".repeat(32))).unwrap();
    let (accepted, said) = verify(folder.path(), "robots");
    assert!(accepted && said.matches("; signed by kitchen\n").count() == 2, "{said}");
    let (accepted, said) = verify(folder.path(), "others");
    assert!(!accepted && said.contains("not recorded by a known robot: 2 of 2"), "{said}");
}

fn program(args: &[&str]) -> Command {
    let mut program = Command::cargo_bin("firmware-host").unwrap();
    program.args(args);
    program
}

fn verify(folder: &Path, robots: &str) -> (bool, String) {
    let mut verify = program(&["buffer", "verify"]);
    verify.arg(folder.join("runs")).arg("--robots").arg(folder.join(robots));
    let output = verify.output().unwrap();
    (output.status.success(), String::from_utf8(output.stdout).unwrap())
}

#[test]
fn a_pose_from_another_program_reaches_the_robot_and_its_recording() {
    let mut scene = Scene::with_another("[run]\n", "[run]\npose_socket = \"{}/pose.sock\"\n");
    scene.drives_first();
    let sender = UnixDatagram::unbound().unwrap();
    sender.connect(scene.path("pose.sock")).unwrap();
    let mut sent = Vec::new();
    for _ in 0..50 {
        let time_ns = MonotonicClock.now_ns();
        let outside = OutsidePose { time_ns, pose: scene.world.home().pose() };
        sender.send(&serde_json::to_vec(&outside).unwrap()).unwrap();
        sent.push(outside);
        pause(20);
    }
    scene.ends_well();
    let recorded = Recorded::open(&scene.path("run")).unwrap();
    let ticks: Vec<_> = recorded.ticks().map(Result::unwrap).collect();
    let poses: Vec<_> = ticks.iter().filter_map(|tick| tick.outside).collect();
    assert!(poses.len() > 3, "{} of {} ticks have a pose from outside", poses.len(), ticks.len());
    assert!(poses.iter().all(|input| sent.contains(&input.outside)));
}
