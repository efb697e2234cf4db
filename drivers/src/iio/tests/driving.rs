//! The driver with its thread: samples, silence, and a unit that comes and goes.

use std::io::Write;
use std::os::unix::net::{UnixListener, UnixStream};

use hal::{Clock, Error as _, ErrorKind, Imu, ImuSample};
use monotonic_clock::{MonotonicClock, monotonic_ns};

use super::super::{IioImu, ImuConfig, ImuPollError, QUEUE, wire};
use super::fake::{Fake, send};
use crate::DeviceState;

/// Far longer than anything that a test waits for, so that a busy computer fails no test.
const PATIENCE_NS: u64 = 60_000_000_000;

type Polled = Result<Option<ImuSample>, ImuPollError>;

/// Polls until `found` returns something.
fn until<T>(imu: &mut IioImu, mut found: impl FnMut(&Polled) -> Option<T>) -> T {
    let end_ns = monotonic_ns() + PATIENCE_NS;
    loop {
        let polled = imu.poll_sample();
        if let Some(found) = found(&polled) {
            return found;
        }
        let status = imu.status();
        let problem = imu.monitor().problem();
        assert!(monotonic_ns() < end_ns, "{polled:?}, {status:?}, {problem:?}");
        MonotonicClock.sleep_until_ns(monotonic_ns() + 1_000_000);
    }
}

fn until_sample(imu: &mut IioImu) -> ImuSample {
    until(imu, |polled| polled.clone().ok().flatten())
}

fn until_error(imu: &mut IioImu, kind: ErrorKind) {
    until(imu, |polled| polled.as_ref().err().filter(|error| error.kind() == kind).map(|_| ()));
}

/// Polls until the thread has done something that no sample shows.
fn until_problem(imu: &mut IioImu, text: &str) {
    let monitor = imu.monitor();
    until(imu, |_| monitor.problem().filter(|problem| problem.contains(text)));
}

fn driver(fake: &Fake, config: &ImuConfig) -> IioImu {
    IioImu::open_in(config, fake.roots()).unwrap().unwrap()
}

#[test]
fn a_robot_without_a_unit_has_no_driver() {
    assert!(IioImu::open(&ImuConfig::default()).unwrap().is_none());
    let bad = ImuConfig { device: "x".to_owned(), rate_hz: 0.0, ..ImuConfig::default() };
    assert!(IioImu::open(&bad).is_err());
}

#[test]
fn samples_come_once_and_in_order() {
    let fake = Fake::new("order");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    let start_ns = monotonic_ns();
    for raw in 1..=3_i16 {
        send(&mut node, start_ns + raw.cast_unsigned() as u64, [0, 0, raw]);
    }
    for radps in [0.5, 1.0, 1.5] {
        assert_eq!(until_sample(&mut imu).angular_radps, [0.0, 0.0, radps]);
    }
    let status = imu.status();
    assert_eq!((status.good, status.bad, status.lost, status.reopened), (3, 0, 0, 0));
    assert_eq!(imu.monitor().setup().unwrap().to_string(), "gyro_3d at 100 Hz, a gyroscope alone");
}

#[test]
fn a_sample_that_cannot_be_is_counted_and_dropped() {
    let fake = Fake::new("bad");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    let now_ns = monotonic_ns();
    send(&mut node, now_ns, [1, 0, 0]);
    send(&mut node, now_ns, [0, 201, 0]);
    send(&mut node, now_ns - 1, [0, 0, 1]);
    send(&mut node, now_ns, [2, 0, 0]);
    assert_eq!(until_sample(&mut imu).angular_radps, [0.5, 0.0, 0.0]);
    assert_eq!(until_sample(&mut imu).angular_radps, [1.0, 0.0, 0.0]);
    assert_eq!((imu.status().good, imu.status().bad), (2, 2));
}

#[test]
fn a_silent_unit_is_a_timeout_and_delivers_again_without_being_opened_again() {
    let fake = Fake::new("silent");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    send(&mut node, monotonic_ns(), [1, 0, 0]);
    until_sample(&mut imu);
    until_error(&mut imu, ErrorKind::Timeout);
    until_problem(&mut imu, "no sample for more than 100 ms");
    assert_eq!(imu.status().state, DeviceState::Silent);
    send(&mut node, monotonic_ns(), [1, 0, 0]);
    until_sample(&mut imu);
    assert_eq!(imu.status().reopened, 0);
}

#[test]
fn a_unit_whose_samples_are_all_refused_is_silent_and_says_why() {
    let fake = Fake::new("refused_samples");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    // The realtime clock is decades ahead of the monotonic one.
    send(&mut node, monotonic_ns() + 1_000_000_000_000_000, [1, 0, 0]);
    until_error(&mut imu, ErrorKind::Timeout);
    until_problem(&mut imu, "times must be of the monotonic clock");
    assert_eq!((imu.status().good, imu.status().bad), (0, 1));
}

#[test]
fn a_unit_that_is_unplugged_is_disconnected_and_works_again_when_it_is_plugged_in() {
    let fake = Fake::new("unplugged");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    send(&mut node, monotonic_ns(), [1, 0, 0]);
    until_sample(&mut imu);
    fake.remove("iio:device0");
    until_error(&mut imu, ErrorKind::Disconnected);
    until_problem(&mut imu, "there is no such device");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    send(&mut node, monotonic_ns(), [2, 0, 0]);
    assert_eq!(until_sample(&mut imu).angular_radps, [1.0, 0.0, 0.0]);
    assert_eq!((imu.status().state, imu.status().reopened), (DeviceState::Working, 1));
}

#[test]
fn a_unit_that_cannot_be_used_is_unsupported_until_it_is_corrected() {
    let fake = Fake::new("unsupported");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    fake.remove("iio:device0/in_anglvel_scale");
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    until_error(&mut imu, ErrorKind::Unsupported);
    fake.write("iio:device0/in_anglvel_scale", "2.0");
    send(&mut node, monotonic_ns(), [1, 0, 0]);
    assert_eq!(until_sample(&mut imu).angular_radps, [2.0, 0.0, 0.0]);
}

#[test]
fn a_caller_that_does_not_poll_gets_the_oldest_samples_and_the_rest_counts_as_lost() {
    let fake = Fake::new("full");
    let mut node = fake.gyroscope(&["x", "y", "z"]);
    let mut imu = driver(&fake, &fake.config("gyro_3d"));
    let start_ns = monotonic_ns();
    let all = QUEUE as u64 + 100;
    for index in 0..all {
        send(&mut node, start_ns + index, [1, 0, 0]);
    }
    let monitor = imu.monitor();
    let end_ns = monotonic_ns() + PATIENCE_NS;
    while monitor.status().good < all {
        assert!(monotonic_ns() < end_ns, "{:?}", monitor.status());
        MonotonicClock.sleep_until_ns(monotonic_ns() + 1_000_000);
    }
    for index in 0..QUEUE as u64 {
        assert_eq!(imu.poll_sample().unwrap().unwrap().time_ns, start_ns + index);
    }
    assert!(!matches!(imu.poll_sample(), Ok(Some(_))));
    assert_eq!(monitor.status().lost, 100);
}

fn sample(radps: f64) -> ImuSample {
    let force_mps2 = Some([0.0, 0.0, 9.8]);
    ImuSample { time_ns: monotonic_ns(), angular_radps: [0.0, 0.0, radps], force_mps2 }
}

#[test]
fn a_unit_in_another_program_is_read_and_connected_to_again_after_it_ended() {
    let fake = Fake::new("socket");
    let path = fake.path("imu");
    let mut imu = driver(&fake, &fake.config(&format!("unix:{}", path.display())));
    until_error(&mut imu, ErrorKind::Disconnected);
    until_problem(&mut imu, "no program accepts connections there");

    let listener = UnixListener::bind(&path).unwrap();
    let (mut program, _) = listener.accept().unwrap();
    let first = sample(0.5);
    let record = wire::encode(&first);
    // A stream may cut a record anywhere.
    program.write_all(&record[..13]).unwrap();
    program.write_all(&record[13..]).unwrap();
    assert_eq!(until_sample(&mut imu), first);

    drop(program);
    until_error(&mut imu, ErrorKind::Disconnected);
    let (mut program, _): (UnixStream, _) = listener.accept().unwrap();
    let second = ImuSample { force_mps2: None, ..sample(-0.5) };
    program.write_all(&wire::encode(&second)).unwrap();
    assert_eq!(until_sample(&mut imu), second);
    assert_eq!(imu.status().reopened, 1);
}
