"""Writes small recordings in the robot's format, without PyTorch."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from PIL import Image

STEP_NS = 100_000_000
ROWS, COLUMNS = 12, 16
CAMERA = {"width": COLUMNS, "height": ROWS, "fx": 8.5, "fy": 8.25, "cx": 7.5, "cy": 5.5}
SCAN = {
    "angle_min_rad": -2.356194490192345,
    "angle_increment_rad": 0.004363323129985824,
    "range_min_m": 0.10000000149011612,
    "range_max_m": 30.0,
    "period_ns": 25_000_000,
}
NAN = "7ff8000000000000"
"""How a tick holds a number that is not finite: the text of its bits."""
STILL = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}

# Foxglove's names and numbers of the fields that are read.
_KINDS = {"double": 1, "doubles": 1, "enum": 5, "fixed32": 7, "string": 9, "bytes": 12}
_MESSAGES: dict[str, list[tuple[str, int, str]]] = {
    "Vector2": [("x", 1, "double"), ("y", 2, "double")],
    "Vector3": [("x", 1, "double"), ("y", 2, "double"), ("z", 3, "double")],
    "Pose": [("position", 1, "Vector3")],
    "CompressedImage": [("data", 2, "bytes"), ("format", 3, "string")],
    "LaserScan": [("ranges", 6, "doubles")],
    "Log": [("level", 2, "enum"), ("message", 3, "string")],
    "Grid": [
        ("pose", 3, "Pose"),
        ("column_count", 4, "fixed32"),
        ("cell_size", 5, "Vector2"),
        ("cell_stride", 7, "fixed32"),
        ("data", 9, "bytes"),
    ],
}


@dataclass(frozen=True)
class Map:
    """A map as the recorder writes it."""

    occupancy: NDArray[np.int8]
    origin_m: tuple[float, float] = (-1.0, 2.0)
    cell_m: float = 0.05


@dataclass(frozen=True)
class Recorded:
    """The messages of a tick."""

    tick: dict[str, Any]
    rgb: NDArray[np.uint8] | None = None
    ranges: list[float] | None = None
    decision: dict[str, Any] | None = None
    log: list[tuple[int, str]] = field(default_factory=list)
    map: Map | None = None

    @property
    def time_ns(self) -> int:
        return int(self.tick["time_ns"])

    @property
    def wheel(self) -> dict[str, Any]:
        wheel: dict[str, Any] = self.tick["wheel"]
        return wheel

    def at(self, time_ns: int) -> Recorded:
        """The same at another time."""
        return replace(self, tick={**self.tick, "time_ns": time_ns})

    def with_wheel(self, **changes: object) -> Recorded:
        """The same with other wheel feedback."""
        return replace(self, tick={**self.tick, "wheel": {**self.wheel, **changes}})

    def decided(self, **changes: object) -> Recorded:
        """The same with another decision."""
        return replace(self, decision={**(self.decision or {}), **changes})


def noise(number: int) -> NDArray[np.uint8]:
    """An image that differs from all others."""
    return np.random.default_rng(number).integers(0, 256, (ROWS, COLUMNS, 3), np.uint8)


def decision(number: int, time_ns: int) -> dict[str, Any]:
    """A decision with a pose and a command; both differ from tick to tick."""
    pose = {"x_m": 0.02 * number, "y_m": 0.01, "yaw_rad": 0.1}
    return {
        "tick": number,
        "time_ns": time_ns,
        "desired": {"linear_mps": 0.0, "angular_radps": 0.0},
        "sent": {"linear_mps": 0.3, "angular_radps": -0.01 * number},
        "goal_m": None,
        "t_odom_base": pose,
        "t_odom_base_at_frame": pose,
        "t_map_odom": {"x_m": 0.5, "y_m": 0.0, "yaw_rad": -0.1},
        "events": [],
    }


def full_tick(number: int) -> Recorded:
    """A tick with an image, a pose and a command."""
    time_ns = STEP_NS * number
    wheel = {"time_ns": time_ns, "x_m": 0.03 * number, "y_m": 0.0, "yaw_rad": 0.01 * number}
    wheel |= {"linear_mps": 0.25, "angular_radps": 0.125 * number}
    tick = {"tick": number, "time_ns": time_ns, "wheel": wheel}
    return Recorded(tick, noise(number), decision=decision(number, time_ns))


def full_ticks(count: int) -> list[Recorded]:
    return [full_tick(number) for number in range(count)]


def closing_tick(last: Recorded) -> Recorded:
    """A tick without an image, which holds the command that answered the image before it."""
    number = int(last.tick["tick"]) + 1
    return replace(full_tick(number).at(last.time_ns + STEP_NS), rgb=None)


def header(ticks: Sequence[Recorded], segment: int, zero_unix_ns: int | None, policy: str) -> dict[str, Any]:
    run = {
        "policy": policy,
        "camera": {**CAMERA, "distortion": {"model": "none"}},
        "t_base_camera": {"translation_m": [0.1, 0.0, 0.8], "rotation_xyzw": [-0.5, 0.5, -0.5, 0.5]},
        "t_base_laser": {"translation_m": [0.0, 0.0, 0.4], "rotation_xyzw": [0.0, 0.0, 0.0, 1.0]},
        "config": {"base": {"track_m": 0.4}},
    }
    first = ticks[0]
    found = {"format_version": 2, "segment": segment, "run": run}
    found |= {"first_tick": first.tick["tick"], "first_time_ns": first.time_ns}
    return found if zero_unix_ns is None else {**found, "zero_unix_ns": zero_unix_ns}


def png(rgb: NDArray[np.uint8]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "PNG")
    return stream.getvalue()


def write_segment(
    file: Path,
    ticks: Sequence[Recorded],
    segment: int = 0,
    zero_unix_ns: int | None = None,
    policy: str = "active",
) -> Path:
    """Writes one segment with a tick or two in each chunk."""
    file.parent.mkdir(parents=True, exist_ok=True)
    writer = _Writer(file)
    writer.json("/robot/header", header(ticks, segment, zero_unix_ns, policy), ticks[0].time_ns)
    for tick in ticks:
        writer.tick(tick)
    writer.finish()
    return file


def write_run(folder: Path, segments: Iterable[Sequence[Recorded]]) -> list[Path]:
    return [
        write_segment(folder / f"recording_{number:04}.mcap", ticks, number) for number, ticks in enumerate(segments)
    ]


def cut(file: Path, share: float) -> None:
    """Keeps this share of the file."""
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])


class _Writer:
    def __init__(self, file: Path) -> None:
        self._mcap = Writer(str(file), chunk_size=2000, compression=CompressionType.ZSTD)
        self._mcap.start()
        descriptors = _descriptors()
        pool = descriptor_pool.DescriptorPool()
        pool.Add(descriptors.file[0])
        self._classes = {
            name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}")) for name in _MESSAGES
        }
        self._schema = descriptors.SerializeToString()
        self._channels: dict[str, int] = {}

    def json(self, topic: str, content: dict[str, Any], time_ns: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._mcap.register_channel(topic, "json", 0)
        self._mcap.add_message(self._channels[topic], time_ns, json.dumps(content).encode(), time_ns)

    def protobuf(self, topic: str, name: str, time_ns: int, **fields: object) -> None:
        if topic not in self._channels:
            schema = self._mcap.register_schema(f"foxglove.{name}", "protobuf", self._schema)
            self._channels[topic] = self._mcap.register_channel(topic, "protobuf", schema)
        message = self._classes[name](**fields)
        self._mcap.add_message(self._channels[topic], time_ns, message.SerializeToString(), time_ns)

    def tick(self, recorded: Recorded) -> None:
        at = recorded.time_ns
        scan = None if recorded.ranges is None else {**SCAN, "time_ns": at + 7, "beams": len(recorded.ranges)}
        promises = {"scan": scan, "frame": recorded.rgb is not None, "truth": False}
        self.json("/robot/tick", {**promises, "decision": recorded.decision is not None, **recorded.tick}, at)
        if recorded.ranges is not None:
            self.protobuf("/scan", "LaserScan", at, ranges=recorded.ranges)
        if recorded.rgb is not None:
            self.protobuf("/camera/image", "CompressedImage", at, data=png(recorded.rgb), format="png")
        if recorded.map is not None:
            self._map(recorded.map, at)
        for level, text in recorded.log:
            self.protobuf("/events", "Log", at, level=level, message=text)
        if recorded.decision is not None:
            self.json("/robot/decision", recorded.decision, at)

    def _map(self, recorded: Map, at: int) -> None:
        classes = self._classes
        x, y = recorded.origin_m
        cells = np.zeros((*recorded.occupancy.shape, 5), np.int8)
        cells[:, :, 4] = recorded.occupancy
        self.protobuf(
            "/map",
            "Grid",
            at,
            pose=classes["Pose"](position=classes["Vector3"](x=x, y=y)),
            column_count=recorded.occupancy.shape[1],
            cell_size=classes["Vector2"](x=recorded.cell_m, y=recorded.cell_m),
            cell_stride=5,
            data=cells.tobytes(),
        )

    def finish(self) -> None:
        self._mcap.finish()  # type: ignore[no-untyped-call]


def _descriptors() -> descriptor_pb2.FileDescriptorSet:
    file = descriptor_pb2.FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for field_name, number, kind in fields:
            added = message.field.add(name=field_name, number=number, label=3 if kind == "doubles" else 1)
            if kind in _KINDS:
                added.type = _KINDS[kind]  # type: ignore[assignment]
            else:
                added.type = descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE
                added.type_name = f".foxglove.{kind}"
    return descriptor_pb2.FileDescriptorSet(file=[file])
