"""Compares a bag of `embodied-depth convert --as ros2` with the recording that it was made of. The bag is decoded by Foxglove's
reader of ROS 2 (PyPI `mcap-ros2-support`), not by the library that wrote it (`rosbags`), and the recording by the `mcap` package:
every message must have the same content, and all times must have moved by the same amount, because the bag has dates. `rosbags`
must find the same messages by the bag's metadata. Called by tools/trainer/tests/exports/test_peers.py; manually, with the Python of
the trainer (`pip install -e "tools/trainer[dev]"`):

    python tests/peers/ros2_bag.py BAG RECORDING.mcap...
    python tests/peers/ros2_bag.py --picture bag.png BAG    # needs matplotlib as well
"""

import argparse
import io
import json
import math
from collections import Counter
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as RosDecoderFactory
from PIL import Image
from rosbags.highlevel import AnyReader

# Topics of the bag, and the topics of the recording with the same content.
TOPICS = {
    "/camera/image": "/camera/image",
    "/camera/camera_info": "/camera/calibration",
    "/scan": "/scan",
    "/odom": "/robot/tick",
    "/tf": "/tf",
    "/map": "/map",
    "/diagnostics": "/robot/decision",
}


def recorded(paths):
    messages = {topic: [] for topic in TOPICS.values()}
    in_json = {"/robot/tick", "/robot/decision"}
    for path in paths:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages(topics=[*set(messages) - in_json]):
                messages[channel.topic].append(message)
            for _, channel, message in reader.iter_messages(topics=[*in_json]):
                content = json.loads(message.data)
                messages[channel.topic].append(content)
                if channel.topic == "/robot/decision":
                    messages["/robot/tick"][-1]["decision"] = content
    return messages


def time_ns(header):
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def same_transform(of_bag, of_recording):
    translation = of_bag.transform.translation
    rotation = of_bag.transform.rotation
    assert [translation.x, translation.y, translation.z] == [getattr(of_recording.translation, name) for name in "xyz"]
    assert [rotation.x, rotation.y, rotation.z, rotation.w] == [getattr(of_recording.rotation, name) for name in "xyzw"]


def transform_of(messages, child):
    return next(transform for transform in messages.transforms if transform.child_frame_id == child)


OFFSETS_NS = set()
"""By how much the times of the bag are later than those of the recording."""


def same_time(header, recorded_ns):
    assert header.stamp.sec > 0, "TF reads a time of zero as the latest"
    OFFSETS_NS.add(time_ns(header) - recorded_ns)


def pixels_of(image):
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)


def same_image(image, of):
    rgb = np.asarray(Image.open(io.BytesIO(of.data)))
    assert np.array_equal(pixels_of(image), rgb)
    same_time(image.header, of.timestamp.ToNanoseconds())


def same_camera_info(info, of):
    assert (info.width, info.height) == (of.width, of.height)
    assert (list(info.k), list(info.r), list(info.p)) == (list(of.K), list(of.R), list(of.P))


def same_scan(scan, of):
    ranges = np.asarray(scan.ranges)
    expected = np.asarray(of.ranges)
    assert scan.header.frame_id == of.frame_id
    assert np.array_equal(ranges, expected, equal_nan=True)
    assert abs(scan.angle_max - of.end_angle) < 1e-6 and abs(scan.angle_min - of.start_angle) < 1e-6
    # ROS has the time of the first beam, the recording that of the revolution's begin, straight behind.
    rotated = 0.5 + of.start_angle / math.tau
    same_time(scan.header, of.timestamp.ToNanoseconds() + round(rotated * round(scan.scan_time * 1e9)))


def same_odometry(odometry, of):
    """The pose is the localized one, the speeds are the wheels'."""
    wheel = of["wheel"]
    localized = of["decision"]["t_odom_base"]
    pose = odometry.pose.pose
    twist = odometry.twist.twist
    assert (pose.position.x, pose.position.y) == (localized["x_m"], localized["y_m"])
    yaw = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    assert abs(math.remainder(yaw - localized["yaw_rad"], math.tau)) < 1e-12
    assert (twist.linear.x, twist.angular.z) == (wheel["linear_mps"], wheel["angular_radps"])
    same_time(odometry.header, wheel["time_ns"])


def same_base_transforms(tf, of):
    for transform, child in zip(tf.transforms, ["base_link", "odom"], strict=True):
        same_transform(transform, transform_of(of, child))


def same_map(grid, of):
    info = grid.info
    cells = np.frombuffer(of.data, np.uint8).reshape(-1, of.cell_stride)
    assert np.array_equal(grid.data, cells[:, 4].view(np.int8))
    assert info.width == of.column_count and info.width * info.height == len(cells)
    assert abs(info.resolution - of.cell_size.x) < 1e-6 and grid.header.frame_id == of.frame_id
    assert (info.origin.position.x, info.origin.position.y) == (of.pose.position.x, of.pose.position.y)
    same_time(grid.header, of.timestamp.ToNanoseconds())


def same_decision(diagnostics, of):
    [status] = diagnostics.status
    values = {entry.key: entry.value for entry in status.values}
    assert int(values["tick"]) == of["tick"] and float(values["desired_mps"]) == of["desired"]["linear_mps"]
    goal = of["goal_m"]
    assert goal is None or [float(values["goal_x_m"]), float(values["goal_y_m"])] == goal
    assert bool(status.message) == bool(of["events"])
    same_time(diagnostics.header, of["time_ns"])


SAME = {
    "/camera/image": same_image,
    "/camera/camera_info": same_camera_info,
    "/scan": same_scan,
    "/odom": same_odometry,
    "/tf": same_base_transforms,
    "/map": same_map,
    "/diagnostics": same_decision,
}


def compare(bag, recordings):
    expected = recorded(recordings)
    counts = Counter()
    for topic, message in messages_of(bag):
        if topic == "/tf_static":
            for mount in message.transforms:
                same_transform(mount, transform_of(expected["/tf"][0], mount.child_frame_id))
        else:
            SAME[topic](message, expected[TOPICS[topic]][counts[topic]])
        counts[topic] += 1
    for topic, source in TOPICS.items():
        assert counts[topic] == len(expected[source]), f"{counts[topic]} of {len(expected[source])} in {topic}"
    assert len(OFFSETS_NS) == 1, OFFSETS_NS
    with AnyReader([bag]) as reader:
        assert {connection.topic: connection.msgcount for connection in reader.connections} == counts
        assert Counter(connection.topic for connection, *_ in reader.messages()) == counts
    print(json.dumps(counts))


def messages_of(bag):
    [file] = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[RosDecoderFactory()], validate_crcs=True)
        for _, channel, _, message in reader.iter_decoded_messages():
            yield channel.topic, message


CELL_M = 0.05
"""Cells in which hits are counted: fewer cells are occupied when every scan lies where it was taken."""


class Path2d:
    """Poses of a robot by time, from odometry."""

    def __init__(self, messages):
        poses = [message.pose.pose for message in messages]
        self.times_ns = np.array([time_ns(message.header) for message in messages])
        self.x_m = np.array([pose.position.x for pose in poses])
        self.y_m = np.array([pose.position.y for pose in poses])
        self.yaw_rad = np.unwrap([2 * math.atan2(pose.orientation.z, pose.orientation.w) for pose in poses])

    def at(self, at_ns):
        """The pose at a time between two measurements, as TF interpolates it."""
        begin_ns = self.times_ns[0]
        times = self.times_ns - begin_ns
        return [np.interp(at_ns - begin_ns, times, of) for of in (self.x_m, self.y_m, self.yaw_rad)]


def hits_of(scan, path, mount):
    """Hits of a scan in `odom`, metres, with the scanner where it was when the scan was taken."""
    ranges = np.asarray(scan.ranges)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    near = np.isfinite(ranges) & (ranges < 8)
    # The pose at the time of the beam straight ahead.
    ahead_s = -scan.angle_min / scan.angle_increment * scan.time_increment
    x_m, y_m, yaw_rad = path.at(time_ns(scan.header) + int(ahead_s * 1e9))
    in_base = ranges[near] * np.array([np.cos(angles[near]), np.sin(angles[near])]) + mount
    rotation = np.array([[math.cos(yaw_rad), -math.sin(yaw_rad)], [math.sin(yaw_rad), math.cos(yaw_rad)]])
    return rotation @ in_base + np.array([[x_m], [y_m]])


def plot(bag, file):
    """Plots camera images, and the hits of all scans with the path by odometry from above."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    by_topic = {}
    for topic, message in messages_of(bag):
        by_topic.setdefault(topic, []).append(message)
    images = by_topic["/camera/image"]
    path = Path2d(by_topic["/odom"])
    laser = transform_of(by_topic["/tf_static"][0], "laser").transform.translation
    mount = np.array([[laser.x], [laser.y]])
    hits = np.hstack([hits_of(scan, path, mount) for scan in by_topic["/scan"]])
    occupied = len(np.unique(np.floor(hits / CELL_M), axis=1).T)
    print(f"{occupied} cells of {100 * CELL_M:.0f} cm are hit by {len(by_topic['/scan'])} scans")
    figure = pyplot.figure(figsize=(10, 8), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=[1, 1.2])
    begin_ns = time_ns(images[0].header)
    for row, at in enumerate([0, len(images) // 2, len(images) - 1]):
        image = images[at]
        axes = figure.add_subplot(grid[row, 0])
        axes.imshow(pixels_of(image))
        axes.set_title(f"/camera/image at {(time_ns(image.header) - begin_ns) * 1e-9:.1f} s")
        axes.axis("off")
    axes = figure.add_subplot(
        grid[:, 1], aspect="equal", title="/scan and /odom", xlabel="x in odom (m)", ylabel="y in odom (m)"
    )
    axes.plot(*hits, ".", markersize=0.5, color="0.35", label="hits of the scanner")
    axes.plot(path.x_m, path.y_m, color="tab:blue", label="path by odometry")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(file, dpi=80)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("bag", type=Path)
    parser.add_argument("recordings", type=Path, nargs="*")
    arguments = parser.parse_args()
    if arguments.picture:
        plot(arguments.bag, arguments.picture)
    else:
        compare(arguments.bag, arguments.recordings)


main()
