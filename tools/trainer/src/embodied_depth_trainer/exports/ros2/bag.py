"""The export of a run as a bag: images, calibration, scans, odometry, transforms, maps and decisions.

Times are dates: a time of zero, at which a simulation begins, means "the latest" to TF.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.dates import Dates
from embodied_depth_trainer.exports.poses import Pose
from embodied_depth_trainer.exports.ros2 import messages, topics
from embodied_depth_trainer.exports.ros2.messages import Frame
from embodied_depth_trainer.exports.ros2.topics import Topic
from embodied_depth_trainer.exports.runs import Run
from embodied_depth_trainer.exports.sentences import Sentences
from embodied_depth_trainer.exports.summary import Summary
from embodied_depth_trainer.exports.ticks import Segment, Tick

# The newest one whose profiles of topics ROS 2 Humble reads; all later distributions read it, too.
METADATA_VERSION: Literal[8] = 8
# Its message definitions are those of all distributions until now.
_TYPES = get_typestore(Stores.ROS2_HUMBLE)
NO_DATE = (
    "The recording has no date, like all of simulations: the run is dated as if it had begun when its first file was "
    "written."
)


def export(run: Run, folder: Path, read: Callable[[int], object] | None = None) -> Summary:
    """Writes the run into the new folder. `read` is called with the number of bytes that were read since the last
    call."""
    dates = Dates.of(run.segments)
    cut = []
    writer = Writer(folder, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        bag = Bag(writer, dates)
        for file in run.segments:
            segment = Segment(file, read)
            sentences = Sentences()
            for tick in segment.ticks():
                bag.add(file, segment.header["run"], tick, sentences)
            if segment.is_cut:
                cut.append(file)
        if not bag.counts:
            raise TrainerError(
                f"{run.path}: no tick can be read, so there is nothing to export; `firmware-host buffer verify` says "
                "what is wrong"
            )
    counts = bag.counts
    return Summary(
        f"{counts.total()} messages, of these {counts[topics.IMAGE.name]} images, {counts[topics.SCAN.name]} scans and "
        f"{counts[topics.MAP.name]} maps; {bag.without_pose} ticks had no pose",
        cut,
        [] if dates.is_recorded else [NO_DATE],
    )


class Bag:
    """A bag that is being written."""

    def __init__(self, writer: Writer, dates: Dates) -> None:
        self.counts: Counter[str] = Counter()
        """Messages by topic."""
        self.without_pose = 0
        """Ticks without a pose, for which the bag has neither odometry nor a transform."""
        self._writer = writer
        self._dates = dates
        self._connections: dict[Topic, Connection] = {}
        self._wheel_ns: int | None = None
        """The time of the wheel feedback that was written last."""

    def add(self, file: Path, run: dict[str, Any], tick: Tick, sentences: Sentences) -> None:
        """The next tick, of a segment with the header `run`."""
        at_ns = self._dates.unix_ns(tick.time_ns)
        try:
            stamp = messages.time(at_ns)
            if not self.counts:
                mounts = [
                    Frame.mount("camera_optical", run["t_base_camera"]),
                    Frame.mount("laser", run["t_base_laser"]),
                ]
                self._put(topics.TF_STATIC, at_ns, messages.transforms(stamp, mounts))
            if tick.image is not None:
                self._put(topics.IMAGE, at_ns, messages.image(stamp, tick.image.pixels()))
                self._put(topics.CAMERA_INFO, at_ns, messages.camera_info(stamp, run["camera"]))
            if tick.ranges is not None:
                scan = tick.recorded["scan"]
                taken = messages.time(self._dates.unix_ns(messages.first_beam_ns(scan)))
                self._put(topics.SCAN, at_ns, messages.laser_scan(taken, scan, tick.ranges))
            if tick.grid is not None:
                self._put(topics.MAP, at_ns, messages.occupancy_grid(stamp, tick.grid))
            if tick.decision is not None:
                said = sentences.of(tick.decision["events"], tick.logged)
                self._put(topics.DIAGNOSTICS, at_ns, messages.diagnostics(stamp, tick.decision, said))
            self._add_wheel(tick, at_ns)
        except (TrainerError, ValueError) as problem:
            raise TrainerError(f"{file}: tick {tick.number}: {problem}") from problem

    def _add_wheel(self, tick: Tick, at_ns: int) -> None:
        """Writes odometry only when the wheel feedback is new: the loop repeats the last feedback when none was
        received."""
        wheel_ns = int(tick.wheel["time_ns"])
        if wheel_ns == self._wheel_ns:
            return
        self._wheel_ns = wheel_ns
        if not Pose.of(tick.wheel).is_finite():
            self.without_pose += 1
            return
        stamp = messages.time(self._dates.unix_ns(wheel_ns))
        frames = [
            Frame.of("odom", "base_link", tick.t_odom_base),
            Frame.of("map", "odom", tick.t_map_odom),
        ]
        self._put(topics.ODOM, at_ns, messages.odometry(stamp, tick.t_odom_base, tick.twist))
        self._put(topics.TF, at_ns, messages.transforms(stamp, frames))

    def _put(self, topic: Topic, at_ns: int, message: object) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic.name, topic.type, typestore=_TYPES, offered_qos_profiles=topic.qos
            )
        self._writer.write(self._connections[topic], at_ns, _TYPES.serialize_cdr(message, topic.type))
        self.counts[topic.name] += 1
