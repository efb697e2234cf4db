//! What the driver writes into sysfs, and what it refuses.

use std::io::ErrorKind;

use super::super::attributes::failed;
use super::super::kernel::{self, KernelDevice};
use super::super::source::Source;
use super::super::{ImuConfig, ImuError, Times};
use super::fake::Fake;

fn open(fake: &Fake, config: &ImuConfig) -> Result<Source, ImuError> {
    kernel::open(config, &config.device.as_str().into(), &fake.roots()).map(|(source, _)| source)
}

fn refusal(fake: &Fake, config: &ImuConfig) -> String {
    open(fake, config).err().map(|error| error.to_string()).unwrap()
}

#[test]
fn a_device_records_rotation_force_and_time_and_nothing_else() {
    let fake = Fake::new("records");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    for (index, axis) in (3..).zip(["x", "y", "z"]) {
        fake.channel("iio:device0", &format!("in_accel_{axis}"), index, "le:s16/16>>0");
    }
    fake.channel("iio:device0", "in_temp", 6, "le:s16/16>>0");
    fake.write("iio:device0/scan_elements/in_temp_en", "1");
    fake.write("iio:device0/in_accel_scale", "0.001");
    let source = open(&fake, &fake.config("gyro_3d")).unwrap();
    for (channel, value) in [
        ("in_anglvel_x", "1"),
        ("in_anglvel_z", "1"),
        ("in_accel_y", "1"),
        ("in_timestamp", "1"),
        ("in_temp", "0"),
    ] {
        let attribute = format!("iio:device0/scan_elements/{channel}_en");
        assert_eq!(fake.read(&attribute), value, "{channel}");
    }
    assert_eq!(fake.read("iio:device0/current_timestamp_clock"), "monotonic");
    assert_eq!(fake.read("iio:device0/in_anglvel_sampling_frequency"), "100");
    assert_eq!(fake.read("iio:device0/buffer/length"), "256");
    assert_eq!(fake.read("iio:device0/buffer/enable"), "1");
    assert_eq!(source.setup.to_string(), "gyro_3d at 100 Hz");
    drop(source);
    assert_eq!(fake.read("iio:device0/buffer/enable"), "0", "the sensor may sleep");
}

#[test]
fn a_device_is_found_by_its_folder_too() {
    let fake = Fake::new("folder");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    let link = fake.path("link");
    std::os::unix::fs::symlink(fake.path("sys/iio:device0"), &link).unwrap();
    open(&fake, &fake.config(link.to_str().unwrap())).unwrap();
    let absent = refusal(&fake, &fake.config("/nonexistent/iio:device7"));
    assert!(absent.contains("no such folder"), "{absent}");
}

#[test]
fn scale_and_offset_may_be_of_each_axis_and_the_boards_matrix_is_applied() {
    let fake = Fake::new("scales");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    fake.write("iio:device0/in_anglvel_x_scale", "2.0");
    fake.write("iio:device0/in_anglvel_y_offset", "-4");
    fake.write("iio:device0/in_mount_matrix", "0, 1, 0; -1, 0, 0; 0, 0, 1");
    let source = open(&fake, &fake.config("gyro_3d")).unwrap();
    let record = [&[1, 0, 2, 0, 3, 0, 0, 0][..], &77_u64.to_le_bytes()].concat();
    let sample = source.decode.sample(&record, 0).unwrap();
    // By hand: x is 1 * 2, y is (2 - 4) * 0.5, z is 3 * 0.5; the unit's x is the chip's y, its y the chip's -x.
    assert_eq!((sample.time_ns, sample.angular_radps), (77, [-1.0, -2.0, 1.5]));
    assert_eq!(sample.force_mps2, None);
}

#[test]
fn a_gyroscope_with_one_axis_serves_if_that_axis_is_upright() {
    let fake = Fake::new("one_axis");
    let _node = fake.gyroscope(&["z"]);
    let level = fake.config("gyro_3d");
    let source = open(&fake, &level).unwrap();
    let record = [&[3, 0, 0, 0, 0, 0, 0, 0][..], &77_u64.to_le_bytes()].concat();
    assert_eq!(source.decode.sample(&record, 0).unwrap().angular_radps, [0.0, 0.0, 1.5]);
    drop(source);
    open(&fake, &ImuConfig { roll_deg: 180.0, ..level.clone() }).unwrap();
    let on_its_side = refusal(&fake, &ImuConfig { roll_deg: 90.0, ..level });
    assert!(on_its_side.contains("it has no in_anglvel_y"), "{on_its_side}");
    // The board says that the chip's y axis is the unit's z axis.
    fake.write("iio:device0/mount_matrix", "1, 0, 0; 0, 0, -1; 0, 1, 0");
    let by_the_board = refusal(&fake, &fake.config("gyro_3d"));
    assert!(by_the_board.contains("it has no in_anglvel_y"), "{by_the_board}");
}

#[test]
fn a_device_that_cannot_tell_the_time_on_the_monotonic_clock_gets_the_time_of_reading() {
    for missing in ["current_timestamp_clock", "scan_elements/in_timestamp_en"] {
        let fake = Fake::new("no_time");
        let _node = fake.gyroscope(&["x", "y", "z"]);
        fake.remove(&format!("iio:device0/{missing}"));
        let source = open(&fake, &fake.config("gyro_3d")).unwrap();
        assert_eq!(source.setup.times, Times::Read, "{missing}");
        assert_eq!(source.decode.sample(&[0; 6], 77).unwrap().time_ns, 77);
    }
}

#[test]
fn the_nearest_rate_is_taken_and_one_that_is_too_slow_for_the_time_out_is_refused() {
    let fake = Fake::new("rate");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    let available = "iio:device0/in_anglvel_sampling_frequency_available";
    fake.write(available, "12.500000 104.000000 208.000000");
    let source = open(&fake, &fake.config("gyro_3d")).unwrap();
    assert_eq!(source.setup.rate_hz, Some(104.0));
    drop(source);
    fake.write(available, "12.500000");
    let slow = refusal(&fake, &fake.config("gyro_3d"));
    assert!(slow.contains("12.5 samples per second") && slow.contains("50 or more"), "{slow}");
}

#[test]
fn a_device_without_a_trigger_takes_its_own_or_the_configured_one_and_sets_its_rate() {
    let fake = Fake::new("trigger");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    fake.write("iio:device0/trigger/current_trigger", "");
    fake.write("trigger3/name", "timer");
    fake.write("trigger3/sampling_frequency", "10");
    let none = refusal(&fake, &fake.config("gyro_3d"));
    assert!(none.contains("no trigger `gyro_3d-dev0`") && none.contains("`timer`"), "{none}");
    let config = ImuConfig { trigger: "timer".to_owned(), ..fake.config("gyro_3d") };
    open(&fake, &config).unwrap();
    assert_eq!(fake.read("iio:device0/trigger/current_trigger"), "timer");
    assert_eq!(fake.read("trigger3/sampling_frequency"), "100");
    fake.write("iio:device0/trigger/current_trigger", "");
    fake.write("trigger0/name", "gyro_3d-dev0");
    open(&fake, &fake.config("gyro_3d")).unwrap();
    assert_eq!(fake.read("iio:device0/trigger/current_trigger"), "gyro_3d-dev0");
}

#[test]
fn what_cannot_be_used_is_named_with_the_way_out() {
    let fake = Fake::new("refused");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    let config = fake.config("gyro_3d");
    let absent = refusal(&fake, &fake.config("bmi160"));
    assert!(absent.contains("IMU bmi160") && absent.contains("there are: `gyro_3d`"), "{absent}");
    for (attribute, text, answer) in [
        ("in_anglvel_scale", "0.000000", "its units are unknown"),
        ("in_anglvel_scale", "fast", "in_anglvel_scale is `fast`"),
        ("in_mount_matrix", "1, 0, 0; 0, 1, 0; 0, 0, -1", "which is no rotation"),
        ("scan_elements/in_anglvel_x_type", "le:f32/32>>0", "in_anglvel_x_type is `le:f32/32>>0`"),
        ("scan_elements/in_anglvel_x_index", "-1", "in_anglvel_x_index is `-1`"),
    ] {
        let path = format!("iio:device0/{attribute}");
        let before = fake.path(&format!("sys/{path}")).exists().then(|| fake.read(&path));
        fake.write(&path, text);
        let said = refusal(&fake, &config);
        assert!(said.contains(answer), "{said}");
        match before {
            Some(text) => fake.write(&path, &text),
            None => fake.remove(&path),
        }
    }
    fake.write("iio:device1/name", "gyro_3d");
    let two = refusal(&fake, &config);
    assert!(two.contains("several devices") && two.contains("iio:device1"), "{two}");
}

#[test]
fn a_device_without_a_gyroscope_or_a_buffer_is_refused() {
    let fake = Fake::new("no_gyroscope");
    let _node = fake.gyroscope(&[]);
    let config = fake.config("gyro_3d");
    let said = refusal(&fake, &config);
    assert!(said.contains("it has no gyroscope") && said.contains("lsm6dsox_gyro"), "{said}");
    fake.remove("iio:device0/buffer");
    let said = refusal(&fake, &config);
    assert!(said.contains("no buffer for it") && said.contains("interrupt line"), "{said}");
}

#[test]
fn a_file_without_permission_or_in_use_is_named_with_the_way_out() {
    let said = |kind: ErrorKind| {
        failed("/dev/iio:device0".into(), "cannot be opened".to_owned(), kind.into()).to_string()
    };
    let denied = said(ErrorKind::PermissionDenied);
    assert!(denied.contains("/dev/iio:device0") && denied.contains("60-embodied-depth.rules"));
    assert!(said(ErrorKind::ResourceBusy).contains("fuser -v /dev/iio:device0"));
    assert!(said(ErrorKind::InvalidInput).contains("cannot be opened: invalid input"));
}

#[test]
fn a_device_whose_folder_vanishes_is_gone() {
    let fake = Fake::new("vanishes");
    let _node = fake.gyroscope(&["x", "y", "z"]);
    let source = open(&fake, &fake.config("gyro_3d")).unwrap();
    assert!(!source.device.as_ref().is_some_and(KernelDevice::is_gone));
    fake.remove("iio:device0");
    assert!(source.device.as_ref().is_some_and(KernelDevice::is_gone));
}
