"""Recordings as the robot writes them, small and made up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer
from torchvision.io import encode_png

from embodied_depth_trainer.frames import Frames

FIELDS = {
    "CompressedImage": [("data", 2, "bytes"), ("format", 3, "string")],
    "RawImage": [("width", 2, "fixed32"), ("height", 3, "fixed32"), ("encoding", 4, "string"), ("data", 6, "bytes")],
}
KINDS = {"bytes": 12, "string": 9, "fixed32": 7}


def schema() -> descriptor_pb2.FileDescriptorSet:
    """Foxglove's field names and numbers, as far as they are read."""
    file = descriptor_pb2.FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3")
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for field, number, kind in fields:
            message.field.add(name=field, number=number, label=1, type=KINDS[kind])
    return descriptor_pb2.FileDescriptorSet(file=[file])


def header(frames: Frames, segment: int) -> dict[str, Any]:
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    camera: dict[str, Any] = {key: getattr(frames.camera, key) for key in keys}
    camera["distortion"] = {"model": "none"}
    mount = {"translation_m": [0.1, 0.0, 0.8], "rotation_xyzw": [-0.5, 0.5, -0.5, 0.5]}
    return {"format_version": 1, "segment": segment, "run": {"camera": camera, "t_base_camera": mount}}


def write_segment(
    file: Path, frames: Frames, wheels: list[dict[str, Any]], segment: int = 0, truth: bool = False
) -> None:
    """One segment with the pictures of `frames` and one pose of the base for each."""
    descriptors = schema()
    pool = descriptor_pool.DescriptorPool()
    pool.Add(descriptors.file[0])
    classes = {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}")) for name in FIELDS}
    writer = Writer(str(file), chunk_size=20_000, compression=CompressionType.ZSTD)
    writer.start()
    coded = descriptors.SerializeToString()
    schemas = {name: writer.register_schema(f"foxglove.{name}", "protobuf", coded) for name in FIELDS}
    channels = {
        "header": writer.register_channel("/robot/header", "json", 0),
        "tick": writer.register_channel("/robot/tick", "json", 0),
        "image": writer.register_channel("/camera/image", "protobuf", schemas["CompressedImage"]),
        "truth": writer.register_channel("/camera/truth_depth", "protobuf", schemas["RawImage"]),
        "map": writer.register_channel("/map", "json", 0),
    }

    def add(channel: str, data: bytes, time_ns: int) -> None:
        writer.add_message(channels[channel], time_ns, data, time_ns)

    add("header", json.dumps(header(frames, segment)).encode(), 0)
    for index, wheel in enumerate(wheels):
        time_ns = int(frames.time_ns[index])
        tick = {"tick": index, "time_ns": time_ns, "wheel": wheel, "frame": True, "truth": truth}
        add("tick", json.dumps(tick).encode(), time_ns)
        png = bytes(encode_png(torch.from_numpy(frames.rgb[index]).permute(2, 0, 1)).numpy())
        add("image", classes["CompressedImage"](data=png, format="png").SerializeToString(), time_ns)
        if truth:
            assert frames.truth_mm is not None
            data = frames.truth_mm[index].astype("<u2").tobytes()
            size = {"width": frames.camera.width, "height": frames.camera.height}
            add("truth", classes["RawImage"](encoding="16UC1", data=data, **size).SerializeToString(), time_ns)
        add("map", b"{}", time_ns)
    writer.finish()  # type: ignore[no-untyped-call]


def straight(count: int, step_m: float = 0.05) -> list[dict[str, Any]]:
    return [{"x_m": step_m * index, "y_m": 0.0, "yaw_rad": 0.0} for index in range(count)]


def dump_of(frames: Frames, folder: Path) -> None:
    """What `firmware-host perceive --recording --dump` writes."""
    assert frames.coarse is not None
    folder.mkdir()
    entries = []
    for index, planes in enumerate(frames.coarse):
        seen = bool(planes[0].any())
        if seen:
            np.save(folder / f"{index:06}.npy", planes)
        pose = frames.t_world_camera[index].ravel().tolist()
        entry = {"name": f"{index:06}", "time_ns": int(frames.time_ns[index]), "t_world_camera": pose}
        entries.append({**entry, "coarse": seen, "rgb": False, "truth": False})
    camera = {key: getattr(frames.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "dump.json").write_text(json.dumps({"format_version": 1, **camera, "frames": entries}))
