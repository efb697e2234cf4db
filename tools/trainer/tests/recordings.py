"""Writes small synthetic recordings in the robot's format."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer
from torchvision.io import encode_png

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.lidar_line import Scan

FIELDS = {
    "CompressedImage": [("data", 2, "bytes"), ("format", 3, "string")],
    "LaserScan": [("ranges", 6, "doubles")],
    "RawImage": [("width", 2, "fixed32"), ("height", 3, "fixed32"), ("encoding", 4, "string"), ("data", 6, "bytes")],
}
IDENTITY = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
KINDS = {"bytes": 12, "string": 9, "fixed32": 7, "doubles": 1}


def schema() -> descriptor_pb2.FileDescriptorSet:
    """Foxglove's field names and numbers of the fields that are read."""
    file = descriptor_pb2.FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3")
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for field, number, kind in fields:
            # Label 3 is `repeated`.
            label = 3 if kind == "doubles" else 1
            message.field.add(name=field, number=number, label=label, type=KINDS[kind])
    return descriptor_pb2.FileDescriptorSet(file=[file])


def header(frames: Frames, segment: int, identity: dict[str, str] | None = None) -> dict[str, Any]:
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    camera: dict[str, Any] = {key: getattr(frames.camera, key) for key in keys}
    camera["distortion"] = {"model": "none"}
    mount = {"translation_m": [0.1, 0.0, 0.8], "rotation_xyzw": [-0.5, 0.5, -0.5, 0.5]}
    laser = {"translation_m": [0.0, 0.0, 0.4], "rotation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    run: dict[str, Any] = {"camera": camera, "t_base_camera": mount, "t_base_laser": laser}
    if identity is not None:
        run["identity"] = identity
    return {"format_version": 2, "segment": segment, "run": run}


def write_segment(
    file: Path,
    frames: Frames,
    wheels: list[dict[str, Any]],
    segment: int = 0,
    truth: bool = False,
    scans: list[Scan] | None = None,
    beams: int | None = None,
    scan_odom: list[dict[str, Any]] | None = None,
    localized: list[dict[str, Any]] | None = None,
    t_map_odom: dict[str, Any] | None = None,
    identity: dict[str, str] | None = None,
) -> None:
    """Writes one segment with the images of `frames`, one pose of the base for each, and optionally a scan before each
    image.

    `beams` overrides the number of beams in the ticks, `scan_odom` the base's poses at the scans' times, `localized`
    the decisions' poses in `odom`. `identity` is what a real robot says of itself.
    """
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
        "scan": writer.register_channel("/scan", "protobuf", schemas["LaserScan"]),
        "truth": writer.register_channel("/camera/truth_depth", "protobuf", schemas["RawImage"]),
        "decision": writer.register_channel("/robot/decision", "json", 0),
        "map": writer.register_channel("/map", "json", 0),
    }

    def add(channel: str, data: bytes, time_ns: int) -> None:
        writer.add_message(channels[channel], time_ns, data, time_ns)

    add("header", json.dumps(header(frames, segment, identity)).encode(), 0)
    for index, wheel in enumerate(wheels):
        time_ns = int(frames.time_ns[index])
        tick: dict[str, Any] = {
            "tick": index,
            "time_ns": time_ns,
            "wheel": {"time_ns": time_ns} | wheel,
            "frame": True,
            "truth": truth,
        }
        tick["scan_odom"] = wheel if scan_odom is None else scan_odom[index]
        scan = None if scans is None else scans[index]
        if scan is not None:
            tick["scan"] = {key: value for key, value in asdict(scan).items() if key != "ranges_m"}
            tick["scan"]["beams"] = beams or len(scan.ranges_m)
        add("tick", json.dumps(tick).encode(), time_ns)
        if scan is not None:
            add("scan", classes["LaserScan"](ranges=scan.ranges_m.tolist()).SerializeToString(), time_ns)
        png = bytes(encode_png(torch.from_numpy(frames.rgb[index]).permute(2, 0, 1)).numpy())
        add("image", classes["CompressedImage"](data=png, format="png").SerializeToString(), time_ns)
        if truth:
            assert frames.truth_mm is not None
            data = frames.truth_mm[index].astype("<u2").tobytes()
            size = {"width": frames.camera.width, "height": frames.camera.height}
            add("truth", classes["RawImage"](encoding="16UC1", data=data, **size).SerializeToString(), time_ns)
        t_odom_base = wheel if localized is None else localized[index]
        poses = {"t_odom_base": t_odom_base, "t_odom_base_at_frame": t_odom_base}
        decision = {**poses, "t_map_odom": t_map_odom or IDENTITY}
        add("decision", json.dumps(decision).encode(), time_ns)
        add("map", b"{}", time_ns)
    writer.finish()  # type: ignore[no-untyped-call]


def straight(count: int, step_m: float = 0.05) -> list[dict[str, Any]]:
    return [{"x_m": step_m * index, "y_m": 0.0, "yaw_rad": 0.0} for index in range(count)]


def dump_of(frames: Frames, folder: Path) -> None:
    """Writes what `firmware-host perceive --recording --dump` writes."""
    assert frames.coarse is not None
    folder.mkdir()
    entries = []
    for index, planes in enumerate(frames.coarse):
        valid = bool(planes[0].any())
        if valid:
            np.save(folder / f"{index:06}.npy", planes)
        if frames.dense is not None:
            np.save(folder / f"{index:06}_dense.npy", frames.dense[index])
        pose = frames.t_world_camera[index].ravel().tolist()
        entry = {"name": f"{index:06}", "time_ns": int(frames.time_ns[index]), "t_world_camera": pose}
        entries.append({**entry, "coarse": valid, "dense": frames.dense is not None, "rgb": False, "truth": False})
    camera = {key: getattr(frames.camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "dump.json").write_text(json.dumps({"format_version": 1, **camera, "frames": entries}))
