//! The complete camera driver with its threads, against a simulated camera in another process.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its fixture has failed")]

use std::path::Path;
use std::process::{Child, Command, Stdio};

use drivers::DeviceState;
use drivers::v4l2::{CameraDeviceConfig, CameraFormat, V4l2Camera, V4l2Error, check};
use hal::{Camera, CameraModel, Clock, Error as _, ErrorKind, Frame};
use hil::video::MovingStripes;
use monotonic_clock::MonotonicClock;

const MS: u64 = 1_000_000;
/// Far longer than any step of these tests takes.
const TIMEOUT_NS: u64 = 30_000 * MS;

struct Simulated(Child);

impl Simulated {
    fn at(path: &Path) -> Self {
        let node = format!("unix:{}", path.display());
        let mut command = Command::new(env!("CARGO_BIN_EXE_hil"));
        Self(command.args(["camera", "--node", &node]).stdout(Stdio::null()).spawn().unwrap())
    }

    fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

fn camera(path: &Path) -> V4l2Camera {
    let mut config =
        CameraDeviceConfig::new(&format!("unix:{}", path.display()), 64, 48, CameraFormat::Yuyv);
    config.fps = Some(100.0);
    // Frames are late on a machine that runs many tests in parallel.
    config.max_age_ms = 10_000;
    V4l2Camera::new(&config, CameraModel::pinhole(64, 48, 1.0)).unwrap()
}

/// Polls until `done`, as the robot's control loop does.
fn poll_until(
    camera: &mut V4l2Camera,
    mut done: impl FnMut(Result<Option<&Frame>, V4l2Error>) -> bool,
) {
    let mut frame = Frame::empty();
    let mut clock = MonotonicClock;
    let start_ns = clock.now_ns();
    loop {
        let polled = camera.poll_frame(&mut frame);
        if done(polled.map(|is_new| is_new.then_some(&frame))) {
            return;
        }
        let now_ns = clock.now_ns();
        assert!(now_ns - start_ns < TIMEOUT_NS, "{:?}", camera.status());
        clock.sleep_until_ns(now_ns + 2 * MS);
    }
}

#[test]
fn every_frame_of_a_simulated_camera_arrives_complete_with_its_own_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera");
    let _simulated = Simulated::at(&path);
    let mut camera = camera(&path);
    let mut last = None;
    let mut count = 0;
    poll_until(&mut camera, |polled| {
        if let Ok(Some(frame)) = polled {
            assert_eq!(
                MovingStripes::time_ns(&frame.data),
                frame.time_ns,
                "image and timestamp belong together"
            );
            assert!(last < Some((frame.sequence, frame.time_ns)), "each is newer than the last");
            last = Some((frame.sequence, frame.time_ns));
            count += 1;
        }
        count == 30
    });
    assert_eq!(camera.export_buffers().unwrap().len(), 4);
}

#[test]
fn a_killed_camera_is_reported_as_disconnected_and_the_driver_reconnects_to_the_next_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera");
    let mut simulated = Simulated::at(&path);
    let mut camera = camera(&path);
    poll_until(&mut camera, |polled| matches!(polled, Ok(Some(_))));
    simulated.kill();
    poll_until(&mut camera, |polled| {
        polled.is_err_and(|error| error.kind() == ErrorKind::Disconnected)
    });
    assert_eq!(camera.status().state, DeviceState::Disconnected);
    let _next = Simulated::at(&path);
    poll_until(&mut camera, |polled| matches!(polled, Ok(Some(_))));
    assert_eq!(camera.status().state, DeviceState::Working);
    // On a busy machine the new camera may have been silent for a second and been restarted.
    assert!(camera.status().reopened >= 1);
}

#[test]
fn check_reports_the_agreed_layout_and_the_reason_when_no_camera_is_connected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera");
    let config =
        CameraDeviceConfig::new(&format!("unix:{}", path.display()), 640, 480, CameraFormat::Yuyv);
    assert_eq!(check(&config).unwrap_err().kind(), ErrorKind::Disconnected);
    let _simulated = Simulated::at(&path);
    let mut clock = MonotonicClock;
    let agreement = loop {
        match check(&config) {
            Ok(agreement) => break agreement,
            Err(error) => assert_eq!(error.kind(), ErrorKind::Disconnected, "{error}"),
        }
        clock.sleep_until_ns(clock.now_ns() + 5 * MS);
    };
    assert_eq!(
        (agreement.layout.width, agreement.layout.height, agreement.layout.stride),
        (640, 480, 1280)
    );
    assert!(agreement.controls.iter().any(|control| control.name == "Gain"));
}
