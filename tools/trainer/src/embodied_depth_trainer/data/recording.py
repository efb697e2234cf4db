"""Reads the robot's recordings (MCAP) as frames in memory."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torchvision.io import ImageReadMode, decode_png

from embodied_depth_trainer.data.frames import Frames, Intrinsics
from embodied_depth_trainer.data.held_out import is_held_out
from embodied_depth_trainer.data.lidar_line import Scan, line
from embodied_depth_trainer.data.messages import (
    DECISION,
    FORMAT_VERSION,
    HEADER,
    IMAGE,
    SCAN,
    TICK,
    TRUTH,
    BrokenError,
    Decoder,
    messages,
    segments,
)
from embodied_depth_trainer.errors import TrainerError


class CompressedImage(Protocol):
    """The fields used of `foxglove.CompressedImage`; the class itself comes from the recording's schema."""

    data: bytes


class LaserScan(Protocol):
    """The fields used of `foxglove.LaserScan`; times, angles and limits are in the tick."""

    ranges: list[float]


class RawImage(Protocol):
    """The fields used of `foxglove.RawImage`."""

    width: int
    height: int
    encoding: str
    data: bytes


@dataclass
class Damage:
    """Segments that end in damage, and why. Everything before the damage is kept: a power cut costs the last chunk
    only."""

    segments: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        names = "; ".join(f"{name}: {why}" for name, why in self.segments.items())
        return f"{len(self.segments)} damaged segments, read up to the damage: {names}"


def read_recording(path: Path) -> tuple[Frames, Damage]:
    """All frames of a run with their localized poses, `t_odom_camera`."""
    damage = Damage()
    reader = _Run(lidar=False)
    for file in segments(path):
        try:
            reader.read(file)
        except BrokenError as problem:
            damage.segments[file.name] = str(problem)
    return reader.frames(path, damage), damage


@dataclass(frozen=True)
class Segment:
    """One segment, which can be read without the others of its run."""

    frames: Frames
    """With localized poses, `t_odom_camera`, and the LiDAR's hits."""
    header: dict[str, Any]
    """The segment's first message."""
    events: dict[str, int]
    """How often each kind of event occurred."""
    damage: str | None
    """What ends it before its end."""


def read_segment(file: Path) -> Segment:
    """All frames of one segment."""
    damage = Damage()
    reader = _Run(lidar=True)
    try:
        reader.read(file)
    except BrokenError as problem:
        damage.segments[file.name] = str(problem)
    frames = reader.frames(file, damage)
    return Segment(frames, reader.header, dict(reader.events), damage.segments.get(file.name))


class _Run:
    """The part of a run that has been read."""

    def __init__(self, lidar: bool) -> None:
        self.camera: Intrinsics | None = None
        self.header: dict[str, Any] = {}
        self.events: Counter[str] = Counter()
        self.topics = {IMAGE, TRUTH, SCAN} if lidar else {IMAGE, TRUTH}
        self.t_camera_base: NDArray[np.floating[Any]] = np.eye(4)
        self.t_base_laser: NDArray[np.float64] = np.eye(4)
        self.scan: Scan | None = None
        self.t_odom_laser: NDArray[np.float64] = np.eye(4)
        self.t_wheels_base: NDArray[np.float64] = np.eye(4)
        self.rgb: list[NDArray[np.uint8]] = []
        self.poses: list[NDArray[np.float64]] = []
        self.times: list[int] = []
        self.frame_ns = 0
        self.truth: list[NDArray[np.uint16]] = []
        self.lines: list[NDArray[np.uint16]] = []
        self.held_out: list[bool] = []

    def read(self, file: Path) -> None:
        t_base_camera = np.eye(4)
        tick: dict[str, Any] | None = None
        decoder = Decoder(file)
        for schema, channel, message in messages(file):
            if channel.topic == HEADER:
                t_base_camera = self._header(file, message.data)
                continue
            if self.camera is None:
                raise BrokenError(f"it does not begin with {HEADER}")
            if channel.topic == TICK:
                tick = json.loads(message.data)
                self.scan = None
            elif channel.topic == DECISION and tick is not None:
                decision = json.loads(message.data)
                self.events.update(event["event"] for event in decision.get("events", []))
                self._localize(file, tick, decision, t_base_camera)
            elif channel.topic in self.topics and tick is not None:
                where = f"{file}: tick {tick['tick']}"
                content = decoder.decode(schema, channel, message)
                if channel.topic == SCAN:
                    self.scan = _scan(file, tick, content)
                    self.t_odom_laser = _pose(*_planar(where, tick, "scan_odom")) @ self.t_base_laser
                elif channel.topic == IMAGE:
                    self.rgb.append(self._image(file, tick, content))
                    x_m, y_m, yaw_rad = _planar(where, tick, "wheel")
                    self.t_wheels_base = _pose(x_m, y_m, yaw_rad)
                    self.poses.append(self.t_wheels_base @ t_base_camera)
                    self.held_out.append(is_held_out(x_m, y_m, yaw_rad))
                    self.times.append(int(tick["time_ns"]))
                    # The wheels are reported for the time of the frame; the tick itself is later.
                    self.frame_ns = int(tick["wheel"]["time_ns"])
                    self.lines.append(self._line(self.t_wheels_base))
                else:
                    self.truth.append(_millimetres(file, tick, content))

    def _localize(
        self, file: Path, tick: dict[str, Any], decision: dict[str, Any], t_base_camera: NDArray[np.float64]
    ) -> None:
        """Replaces the wheels' pose of the tick's frame by the localized one of its exposure, which is earlier than its
        time stamp.

        Neighbouring frames are compared in `odom`, which never jumps; places are compared in `map`.
        """
        if not self.times or self.times[-1] != int(tick["time_ns"]):
            return
        where = f"{file}: the decision of tick {tick['tick']}"
        t_odom_base = _pose(*_planar(where, decision, "t_odom_base"))
        t_odom_frame = _pose(*_planar(where, decision, "t_odom_base_at_frame"))
        self.poses[-1] = t_odom_frame @ t_base_camera
        # The scan's pose is that of the wheels, so the frame's is too.
        self.lines[-1] = self._line(self.t_wheels_base @ np.linalg.inv(t_odom_base) @ t_odom_frame)
        t_map_base = _pose(*_planar(where, decision, "t_map_odom")) @ t_odom_frame
        yaw_rad = np.arctan2(t_map_base[1, 0], t_map_base[0, 0])
        self.held_out[-1] = is_held_out(t_map_base[0, 3], t_map_base[1, 3], yaw_rad)

    def _header(self, file: Path, data: bytes) -> NDArray[np.float64]:
        header = json.loads(data)
        version = header.get("format_version")
        if version != FORMAT_VERSION:
            raise TrainerError(f"{file} has format version {version}, this trainer reads {FORMAT_VERSION}; update it")
        camera = header["run"]["camera"]
        if camera["distortion"]["model"] != "none":
            raise TrainerError(
                f"{file}: the images have the distortion {camera['distortion']}; record rectified images for training"
            )
        found = Intrinsics(*(camera[key] for key in ("width", "height", "fx", "fy", "cx", "cy")))
        if self.camera not in (None, found):
            raise TrainerError(
                f"{file} was recorded with {found}, the segments before it with {self.camera}; "
                "put each run into its own directory"
            )
        self.camera = found
        self.header = header
        t_base_camera = _rigid(header["run"]["t_base_camera"])
        if SCAN in self.topics:
            self.t_camera_base = np.linalg.inv(t_base_camera)
            self.t_base_laser = _rigid(header["run"]["t_base_laser"])
        return t_base_camera

    def _line(self, t_odom_base: NDArray[np.floating[Any]]) -> NDArray[np.uint16]:
        """The LiDAR's line in the frame that was read last; empty where its tick has no scan close enough in time. The
        robot may have moved between scan and frame, so the scan is placed at the pose of its own time."""
        assert self.camera is not None
        if self.scan is None or not self.scan.belongs_to(self.frame_ns):
            return np.zeros((2, self.camera.width), np.uint16)
        return line(self.camera, self.t_camera_base @ np.linalg.inv(t_odom_base) @ self.t_odom_laser, self.scan)

    def _image(self, file: Path, tick: dict[str, Any], message: CompressedImage) -> NDArray[np.uint8]:
        assert self.camera is not None
        try:
            coded = torch.frombuffer(bytearray(message.data), dtype=torch.uint8)
            image: NDArray[np.uint8] = decode_png(coded, ImageReadMode.RGB).permute(1, 2, 0).contiguous().numpy()
        except RuntimeError as problem:
            raise BrokenError(f"the image of tick {tick['tick']} is no PNG: {problem}") from problem
        if image.shape[:2] != (self.camera.height, self.camera.width):
            raise TrainerError(f"{file}: tick {tick['tick']} has an image of {image.shape[:2]} from {self.camera}")
        return image

    def frames(self, path: Path, damage: Damage) -> Frames:
        if self.camera is None or not self.rgb:
            why = f" ({damage})" if damage.segments else ""
            raise TrainerError(f"{path} holds no frame{why}; record a run with `firmware-host explore`")
        count = len(self.rgb)
        truth = np.stack(self.truth) if len(self.truth) == count else None
        times = np.array(self.times, np.int64)
        lidar = np.stack(self.lines) if SCAN in self.topics else None
        run = np.zeros(count, np.int32)
        held_out = np.array(self.held_out, np.bool_)
        rgb = np.stack(self.rgb)
        poses = np.stack(self.poses)
        return Frames(self.camera, rgb, poses, times, run, truth, lidar=lidar, held_out=held_out)


def _planar(where: str, message: dict[str, Any], key: str) -> tuple[float, float, float]:
    """A planar pose in metres and radians."""
    pose = message.get(key) or {}
    values = [pose.get(name) for name in ("x_m", "y_m", "yaw_rad")]
    # Numbers that are not finite are recorded as text.
    if not all(isinstance(value, (int, float)) and np.isfinite(value) for value in values):
        raise TrainerError(
            f"{where} has no pose in `{key}` (x_m, y_m, yaw_rad = {values}); train on a recording whose odometry worked"
        )
    x_m, y_m, yaw_rad = (float(value) for value in values if value is not None)
    return x_m, y_m, yaw_rad


def _pose(x_m: float, y_m: float, yaw_rad: float) -> NDArray[np.float64]:
    """A planar pose as rigid transform [4, 4]."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    pose[:2, 3] = x_m, y_m
    return pose


def _rigid(pose: dict[str, Any]) -> NDArray[np.float64]:
    """Rigid transform [4, 4] from a translation and a unit quaternion x y z w."""
    x, y, z, w = pose["rotation_xyzw"]
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = pose["translation_m"]
    return matrix


def _scan(file: Path, tick: dict[str, Any], message: LaserScan) -> Scan:
    entry = tick.get("scan")
    if not entry or entry["beams"] != len(message.ranges):
        raise BrokenError(f"tick {tick['tick']} has {entry} for a scan with {len(message.ranges)} beams")
    return Scan.of(entry, message.ranges)


def _millimetres(file: Path, tick: dict[str, Any], image: RawImage) -> NDArray[np.uint16]:
    if image.encoding != "16UC1" or len(image.data) != 2 * image.width * image.height:
        raise TrainerError(
            f"{file}: tick {tick['tick']}: ground truth of {image.encoding} with {len(image.data)} bytes is not packed "
            "16UC1; use the recording as the robot wrote it"
        )
    return np.frombuffer(image.data, "<u2").reshape(image.height, image.width).astype(np.uint16)
