"""Exports as ROS 2 bags, read back with rosbags. `tests/peers` compares a bag with the recording it was made of."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosbags.typesys.stores.ros2_humble as ros
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.exports.ros2 import messages, topics
from embodied_depth_trainer.exports.ros2.messages import distances
from embodied_depth_trainer.exports.ros2.topics import Topic

from .segments import CAMERA, NAN, SCAN, STEP_NS, STILL, Map, Recorded, cut, full_ticks, write_run, write_segment
from .segments import full_tick as tick_without_scan

# Unix time at which the clock of the recordings is zero.
ZERO_UNIX_NS = 1_790_000_000_000_000_000
EVERY_TOPIC = (topics.IMAGE, topics.CAMERA_INFO, topics.SCAN, topics.ODOM, topics.TF, topics.DIAGNOSTICS)


def full_tick(number: int) -> Recorded:
    """A tick with an image, a scan with every kind of beam, odometry and velocity."""
    ranges = [1.25, np.inf, -np.inf, np.nan, float(np.float32(0.1 + number))]
    return replace(tick_without_scan(number), ranges=ranges)


def convert(run: Path, to: Path) -> int:
    return main(["convert", str(run), "--as", "ros2", "--out", str(to)])


def exported(ticks: Sequence[Recorded], folder: Path) -> dict[str, list[Any]]:
    """The messages of the bag of a run with these ticks, by topic."""
    write_segment(folder / "run/recording_0000.mcap", ticks, zero_unix_ns=ZERO_UNIX_NS)
    assert convert(folder / "run", folder / "bag") == 0
    return read(folder / "bag")


def read(bag: Path) -> dict[str, list[Any]]:
    found = defaultdict(list)
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return found


def head(message: Any) -> tuple[int, str]:  # noqa: ANN401
    """Time on the run's clock, and frame."""
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec - ZERO_UNIX_NS, message.header.frame_id


def xyzw(rotation: Any) -> list[float]:  # noqa: ANN401
    return [rotation.x, rotation.y, rotation.z, rotation.w]


def test_every_image_scan_and_pose_is_exported_as_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ticks = [full_tick(number) for number in range(13, 25)]
    found = exported(ticks, tmp_path)
    assert "73 messages, of these 12 images, 12 scans and 0 maps; 0 ticks had no pose" in capsys.readouterr().out
    assert {name: len(messages) for name, messages in found.items()} == {
        topics.TF_STATIC.name: 1,
        **{topic.name: len(ticks) for topic in EVERY_TOPIC},
    }
    for at, tick in enumerate(ticks):
        number = 13 + at
        image, info, scan, odom, tf, _ = (found[topic.name][at] for topic in EVERY_TOPIC)
        assert head(image) == (tick.time_ns, "camera_optical")
        assert (image.height, image.width, image.step, image.encoding, image.is_bigendian) == (12, 16, 48, "rgb8", 0)
        assert tick.rgb is not None
        assert np.array_equal(image.data.reshape(12, 16, 3), tick.rgb)

        assert (head(info), info.height, info.width) == (head(image), 12, 16)
        assert (info.distortion_model, info.d.tolist()) == ("plumb_bob", [0.0] * 5)
        fx, fy, cx, cy = (CAMERA[key] for key in ("fx", "fy", "cx", "cy"))
        assert info.k.tolist() == [fx, 0, cx, 0, fy, cy, 0, 0, 1]
        assert info.p.tolist() == [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]

        # The scan's own time: its first beam is 45 degrees from straight behind.
        assert head(scan) == (tick.time_ns + 7 + 25_000_000 // 8, "laser")
        assert (scan.angle_min, scan.angle_increment) == (
            np.float32(SCAN["angle_min_rad"]),
            np.float32(SCAN["angle_increment_rad"]),
        )
        assert scan.angle_max == pytest.approx(scan.angle_min + 4 * scan.angle_increment, abs=1e-6)
        assert (scan.range_min, scan.range_max, scan.scan_time) == (np.float32(0.1), 30, np.float32(0.025))
        assert scan.time_increment == pytest.approx(0.025 / 1440, abs=1e-9)
        # REP-117.
        assert scan.ranges[:3].tolist() == [1.25, np.inf, -np.inf]
        assert np.isnan(scan.ranges[3])
        assert scan.ranges[4] == np.float32(0.1 + number)
        assert len(scan.intensities) == 0

        assert (head(odom), odom.child_frame_id) == ((tick.wheel["time_ns"], "odom"), "base_link")
        pose, twist = odom.pose.pose, odom.twist.twist
        assert (pose.position.x, pose.position.y, pose.position.z) == (0.02 * number, 0.01, 0.0)
        assert (pose.orientation.x, pose.orientation.y) == (0, 0)
        assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(0.1, abs=1e-15)
        assert (twist.linear.x, twist.angular.z) == (0.25, 0.125 * number)
        # Unknown: they are not recorded.
        assert not odom.pose.covariance.any()

        base, origin = tf.transforms
        assert (head(base), base.child_frame_id) == (head(odom), "base_link")
        assert base.transform.translation.x == pose.position.x
        assert xyzw(base.transform.rotation) == xyzw(pose.orientation)
        assert (head(origin), origin.child_frame_id) == ((tick.wheel["time_ns"], "map"), "odom")
        assert origin.transform.translation.x == 0.5


def test_the_beams_of_a_scanner_that_rotates_clockwise_are_written_in_the_order_of_their_times() -> None:
    recorded = {
        **SCAN,
        "angle_min_rad": -1.5,
        "angle_increment_rad": 1.0,
        "beams": 4,
        "time_ns": 100,
        "clockwise": True,
    }
    scan = messages.laser_scan(messages.time(0), recorded, np.array([1.0, 2.0, 3.0, 4.0]))
    assert scan.ranges.tolist() == [4, 3, 2, 1]
    assert (scan.angle_min, scan.angle_max, scan.angle_increment) == (1.5, -1.5, -1)
    assert scan.time_increment > 0
    # From straight behind to 1.5 rad, clockwise.
    share = (np.pi - 1.5) / (2 * np.pi)
    assert messages.first_beam_ns(recorded) == 100 + round(share * 25_000_000)


def test_sensor_mounts_and_maps_are_latched_for_late_subscribers(tmp_path: Path) -> None:
    occupancy = np.array([[-1, 0, 100], [100, 0, -1]], np.int8)
    ticks = [replace(full_tick(number), map=Map(occupancy)) for number in (4, 5)]
    found = exported(ticks, tmp_path)
    [mounts] = found[topics.TF_STATIC.name]
    names = [(mount.header.frame_id, mount.child_frame_id) for mount in mounts.transforms]
    assert names == [("base_link", "camera_optical"), ("base_link", "laser")]
    at = mounts.transforms[0].transform
    assert (at.translation.x, at.translation.z, at.rotation.x, at.rotation.w) == (0.1, 0.8, -0.5, 0.5)
    grids = found[topics.MAP.name]
    assert [head(grid) for grid in grids] == [(4 * STEP_NS, "map"), (5 * STEP_NS, "map")]
    info = grids[0].info
    assert (info.resolution, info.width, info.height) == (np.float32(0.05), 3, 2)
    assert (info.origin.position.x, info.origin.position.y, info.origin.orientation.w) == (-1, 2, 1)
    assert grids[0].data.reshape(2, 3).tolist() == occupancy.tolist()
    with AnyReader([tmp_path / "bag"]) as reader:
        latched = {connection.topic for connection in reader.connections if is_latched(connection.ext)}
    assert latched == {topics.TF_STATIC.name, topics.MAP.name}


def is_latched(connection: Any) -> bool:  # noqa: ANN401
    return [profile.durability for profile in connection.offered_qos_profiles] == [QosDurability.TRANSIENT_LOCAL]


def test_the_metadata_is_of_the_newest_version_that_humble_reads(tmp_path: Path) -> None:
    exported([full_tick(0), full_tick(1)], tmp_path)
    text = (tmp_path / "bag/metadata.yaml").read_text()
    assert "version: 8\n" in text
    assert "storage_identifier: mcap\n" in text
    assert "message_count: 13\n" in text
    assert {file.name for file in (tmp_path / "bag").iterdir()} == {"bag.mcap", "metadata.yaml", "export.json"}


def test_several_segments_become_one_bag_and_a_cut_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ticks = full_ticks(80)
    *_, last = write_run(tmp_path / "run", [ticks[:30], ticks[30:60], ticks[60:]])
    cut(last, 0.5)
    assert convert(tmp_path / "run", tmp_path / "bag") == 1
    assert "the end of recording_0002.mcap, which is cut" in capsys.readouterr().err
    images = read(tmp_path / "bag")[topics.IMAGE.name]
    assert 60 < len(images) < 80
    times = [(image.header.stamp.sec, image.header.stamp.nanosec) for image in images]
    assert times == sorted(set(times))


def test_repeated_wheel_feedback_and_poses_that_are_not_finite_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = full_tick(0)
    ticks = [first, full_tick(1).with_wheel(**first.wheel), full_tick(2).with_wheel(x_m=NAN)]
    found = exported(ticks, tmp_path)
    assert (len(found[topics.ODOM.name]), len(found[topics.TF.name]), len(found[topics.SCAN.name])) == (1, 1, 3)
    assert "1 ticks had no pose" in capsys.readouterr().out


def test_a_tick_without_a_decision_has_the_pose_of_its_wheels(tmp_path: Path) -> None:
    found = exported([replace(full_tick(7), decision=None)], tmp_path)
    [odom] = found[topics.ODOM.name]
    assert odom.pose.pose.position.x == 0.03 * 7
    [tf] = found[topics.TF.name]
    assert tf.transforms[1].transform.translation.x == 0
    assert topics.DIAGNOSTICS.name not in found


def test_a_decision_is_a_diagnostic_with_its_reasons(tmp_path: Path) -> None:
    events = [{"event": "goal_reached"}, {"event": "stands_without_frames"}]
    log = [(2, "goal reached"), (3, "stopped: no frame has arrived for too long")]
    tick = replace(full_tick(7).decided(events=events, goal_m=[1.5, -2.0], lost="carried"), log=log)
    [found] = exported([tick], tmp_path)[topics.DIAGNOSTICS.name]
    [status] = found.status
    assert head(found) == (7 * STEP_NS, "")
    assert (status.level, status.name) == (1, "embodied_depth: decision")
    assert status.message == "goal reached; stopped: no frame has arrived for too long"
    assert {entry.key: entry.value for entry in status.values} == {
        "tick": "7",
        "desired_mps": "0",
        "desired_radps": "0",
        "sent_mps": "0.3",
        "sent_radps": "-0.07",
        "goal_x_m": "1.5",
        "goal_y_m": "-2",
        "lost": "scans changed while the wheels stood: the robot was carried",
    }


def test_a_simulation_that_begins_at_zero_has_no_stamp_that_tf_reads_as_the_latest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / "run", [full_ticks(2)])
    assert convert(tmp_path / "run", tmp_path / "bag") == 0
    assert "The recording has no date" in capsys.readouterr().out
    [first, _] = read(tmp_path / "bag")[topics.IMAGE.name]
    assert first.header.stamp.sec > 1_700_000_000


def test_the_date_of_the_last_dated_segment_is_that_of_all_times(tmp_path: Path) -> None:
    ticks = full_ticks(3)
    for number, zero in enumerate([1_000, ZERO_UNIX_NS, None]):
        write_segment(tmp_path / f"run/recording_{number:04}.mcap", ticks[number : number + 1], number, zero)
    assert convert(tmp_path / "run", tmp_path / "bag") == 0
    times = [head(image)[0] for image in read(tmp_path / "bag")[topics.IMAGE.name]]
    assert times == [tick.time_ns for tick in ticks]


def test_a_time_that_ros_cannot_represent_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_segment(tmp_path / "run/recording_0000.mcap", [full_tick(0).at(3_000_000_000_000_000_000)])
    assert convert(tmp_path / "run", tmp_path / "bag") == 1
    assert "68 years" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["run"]


def test_hits_that_are_not_finite_have_the_bits_that_the_scanner_reported() -> None:
    hit = np.array([np.nan], np.float32).view(np.uint32) | 5
    (coded,) = struct.unpack("<d", struct.pack("<Q", 0x7FF8_0001_0000_0000 | int(hit[0])))
    found = distances(np.array([1.5, coded, np.nan]))
    assert found[0] == 1.5
    assert found[1:].view(np.uint32).tolist() == [int(hit[0]), 0x7FC0_0000]
    with pytest.raises(ValueError, match=r"0\.1 is not a distance"):
        distances(np.array([0.1]))


@pytest.mark.parametrize("topic", EVERY_TOPIC)
def test_topics_have_rosbags_own_types(topic: Topic) -> None:
    package, _, name = topic.type.split("/")
    assert hasattr(ros, f"{package}__msg__{name}")


def test_poses_in_a_bag_are_those_of_a_robot_that_stands(tmp_path: Path) -> None:
    still = full_tick(0).decided(t_odom_base=STILL, t_map_odom=STILL)
    [tf] = exported([still], tmp_path)[topics.TF.name]
    assert [xyzw(transform.transform.rotation) for transform in tf.transforms] == [[0, 0, 0, 1]] * 2
