//! Snapshots of older layouts.

use super::test_robot::{cells, drive, robot};
use super::*;
use crate::snapshot::{
    SNAPSHOT_WITHOUT_IMU, SNAPSHOT_WITHOUT_SCANNER_TIME, SNAPSHOT_WITHOUT_SEPARATE_MAPS,
};

const OLDER: [u32; 3] =
    [SNAPSHOT_WITHOUT_IMU, SNAPSHOT_WITHOUT_SCANNER_TIME, SNAPSHOT_WITHOUT_SEPARATE_MAPS];

/// A snapshot of `robot` as a program of an older layout wrote it: without what was added later at the end.
fn of_layout(robot: &Robot, layout: u32) -> Vec<u8> {
    let mut added = Vec::new();
    if layout <= SNAPSHOT_WITHOUT_IMU {
        robot.location.write_gyro(&mut added);
        robot.tilt.write(&mut added);
    }
    if layout <= SNAPSHOT_WITHOUT_SCANNER_TIME {
        robot.watch.write_layout_13(&mut added);
    }
    if layout <= SNAPSHOT_WITHOUT_SEPARATE_MAPS {
        robot.location.write_layout_14(&mut added);
        robot.separate_maps.write(&mut added);
    }
    let mut bytes = robot.snapshot();
    bytes.truncate(bytes.len() - added.len());
    bytes[..4].copy_from_slice(&layout.to_le_bytes());
    bytes
}

#[test]
fn snapshots_of_the_three_layouts_before_are_read_as_those_of_robots_without_what_came_later() {
    let mut first = robot();
    drive(&mut first);
    for layout in OLDER {
        let mut second = robot();
        drive(&mut second);
        second.restore(&of_layout(&first, layout)).unwrap();
        assert_eq!(cells(second.map()), cells(first.map()), "{layout}");
        assert_eq!(second.poses(), first.poses(), "{layout}");
        assert_eq!(second.maps(), 1, "{layout}");
        let mut layout_13 = Vec::new();
        second.watch.write_layout_13(&mut layout_13);
        let mut nothing = Vec::new();
        CalibrationWatch::default().write_layout_13(&mut nothing);
        assert_eq!(layout_13 == nothing, layout <= SNAPSHOT_WITHOUT_SCANNER_TIME, "{layout}");
    }
}

#[test]
fn a_snapshot_of_an_older_layout_that_is_too_long_or_too_short_is_refused() {
    let mut first = robot();
    drive(&mut first);
    for layout in OLDER.into_iter().chain([SNAPSHOT_VERSION]) {
        let bytes = of_layout(&first, layout);
        let short = robot().restore(&bytes[..bytes.len() - 1]);
        assert!(matches!(short, Err(SnapshotError::Damaged(_))), "{layout}: {short:?}");
        let long = robot().restore(&[bytes.as_slice(), &[0]].concat());
        assert!(matches!(long, Err(SnapshotError::Damaged(_))), "{layout}: {long:?}");
    }
}
