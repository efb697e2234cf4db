"""Compares a bag of `firmware-host buffer export --as ros2`, read by an independent reader (PyPI `rosbags`), with the
recording as read by the `mcap` package: every message must have the same content. Called by
firmware-host/tests/ros2_peer.rs; manually:

    python3 -m venv target/peers && target/peers/bin/pip install -r tests/peers/requirements.txt
    target/peers/bin/python tests/peers/ros2_bag.py BAG RECORDING.mcap...
    target/peers/bin/python tests/peers/ros2_bag.py --picture bag.png BAG    # needs matplotlib as well
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
from PIL import Image
from rosbags.highlevel import AnyReader

# Topics of the bag, and the topics of the recording with the same content.
TOPICS = {
    "/camera/image": "/camera/image",
    "/camera/camera_info": "/camera/calibration",
    "/scan": "/scan",
    "/odom": "/robot/tick",
    "/tf": "/tf",
}


def recorded(paths):
    messages = {topic: [] for topic in TOPICS.values()}
    for path in paths:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages(topics=[*set(messages) - {"/robot/tick"}]):
                messages[channel.topic].append(message)
            for _, channel, message in reader.iter_messages(topics=["/robot/tick", "/robot/decision"]):
                if channel.topic == "/robot/tick":
                    messages["/robot/tick"].append(json.loads(message.data))
                else:
                    messages["/robot/tick"][-1]["decision"] = json.loads(message.data)
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


def same_image(image, of):
    rgb = np.asarray(Image.open(io.BytesIO(of.data)))
    assert np.array_equal(image.data.reshape(image.height, image.width, 3), rgb)
    assert time_ns(image.header) == of.timestamp.ToNanoseconds()


def same_camera_info(info, of):
    assert (info.width, info.height) == (of.width, of.height)
    assert (list(info.k), list(info.r), list(info.p)) == (list(of.K), list(of.R), list(of.P))


def same_scan(scan, of):
    ranges = scan.ranges.astype(np.float64)
    expected = np.asarray(of.ranges)
    assert len(ranges) == len(expected) and scan.header.frame_id == of.frame_id
    assert np.array_equal(ranges[np.isfinite(ranges)], expected[np.isfinite(ranges)])
    assert abs(scan.angle_max - of.end_angle) < 1e-6 and abs(scan.angle_min - of.start_angle) < 1e-6
    assert time_ns(scan.header) == of.timestamp.ToNanoseconds()


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
    assert time_ns(odometry.header) == wheel["time_ns"]


def same_base_transforms(tf, of):
    for transform, child in zip(tf.transforms, ["base_link", "odom"], strict=True):
        same_transform(transform, transform_of(of, child))


SAME = {
    "/camera/image": same_image,
    "/camera/camera_info": same_camera_info,
    "/scan": same_scan,
    "/odom": same_odometry,
    "/tf": same_base_transforms,
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
    print(json.dumps(counts))


def messages_of(bag):
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            yield connection.topic, reader.deserialize(data, connection.msgtype)


def plot(bag, path):
    """Plots camera images, and a top view of the path by odometry with the scanner's hits."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    images = []
    path_points = []
    hits = []
    pose = None
    for topic, message in messages_of(bag):
        if topic == "/camera/image":
            images.append((time_ns(message.header), message.data.reshape(message.height, message.width, 3)))
        elif topic == "/odom":
            at = message.pose.pose.position
            rotation = message.pose.pose.orientation
            pose = (at.x, at.y, 2 * math.atan2(rotation.z, rotation.w))
            path_points.append(pose)
        elif topic == "/scan" and pose and len(path_points) % 10 == 1:
            ranges = message.ranges
            angles = pose[2] + message.angle_min + message.angle_increment * np.arange(len(ranges))
            near = np.isfinite(ranges) & (ranges < 8)
            beams = ranges[near] * np.array([np.cos(angles[near]), np.sin(angles[near])])
            hits.append(beams + np.array(pose[:2])[:, None])
    figure = pyplot.figure(figsize=(10, 8), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=[1, 1.2])
    for row, at in enumerate([0, len(images) // 2, len(images) - 1]):
        axes = figure.add_subplot(grid[row, 0])
        axes.imshow(images[at][1])
        axes.set_title(f"/camera/image at {images[at][0] * 1e-9:.1f} s")
        axes.axis("off")
    axes = figure.add_subplot(grid[:, 1], aspect="equal", title="/scan and /odom", xlabel="odom x (m)", ylabel="odom y (m)")
    axes.plot(*np.hstack(hits), ".", markersize=1, color="0.5", label="hits of the scanner")
    axes.plot([x for x, _, _ in path_points], [y for _, y, _ in path_points], color="tab:blue", label="path by odometry")
    axes.legend(loc="upper right")
    figure.savefig(path, dpi=80)


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
