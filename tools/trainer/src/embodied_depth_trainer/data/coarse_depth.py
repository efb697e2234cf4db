"""Reads the folder that `firmware-host perceive --dump` writes: coarse and dense depth as the robot computes them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frame_set import GivenDepth
from embodied_depth_trainer.data.frames import Frames, Intrinsics
from embodied_depth_trainer.errors import TrainerError

FORMAT_VERSION = 1


def _index(folder: Path) -> tuple[Intrinsics, list[dict[str, Any]]]:
    try:
        index = json.loads((folder / "dump.json").read_text())
    except FileNotFoundError:
        raise TrainerError(
            f"{folder} holds no dump.json; write it with `firmware-host perceive --recording RUN --out DIR "
            f"--dump {folder}` (or --dataset)"
        ) from None
    if index.get("format_version") != FORMAT_VERSION:
        raise TrainerError(
            f"{folder} has format version {index.get('format_version')}, this trainer reads {FORMAT_VERSION}; "
            "write it again with a matching firmware-host"
        )
    return Intrinsics(*(index[key] for key in ("width", "height", "fx", "fy", "cx", "cy"))), index["frames"]


def _planes(folder: Path, camera: Intrinsics, entry: dict[str, Any], kind: GivenDepth = "coarse") -> NDArray[np.uint16]:
    if not entry.get(kind):
        return np.zeros((2, camera.height, camera.width), np.uint16)
    file = folder / f"{entry['name']}{'' if kind == 'coarse' else '_dense'}.npy"
    planes: NDArray[np.uint16] = np.load(file, allow_pickle=False)
    if planes.shape != (2, camera.height, camera.width) or planes.dtype != np.uint16:
        raise TrainerError(f"{file} is {planes.dtype}{planes.shape}; write the dump again")
    return planes


def _dense(folder: Path, camera: Intrinsics, entries: Sequence[dict[str, Any]]) -> NDArray[np.uint16] | None:
    """Dense depth; `None` for a robot that computes none."""
    if not any(entry.get("dense") for entry in entries):
        return None
    return np.stack([_planes(folder, camera, entry, "dense") for entry in entries])


class CoarseDump:
    """The coarse depth of a recording; frames are matched by their times."""

    def __init__(self, folder: Path, frames: Frames) -> None:
        """Opens the folder that was dumped from the recording of these frames."""
        self.folder = folder
        self.camera, entries = _index(folder)
        if self.camera != frames.camera:
            raise TrainerError(
                f"{folder} was made with {self.camera}, the recording with {frames.camera}; dump it again"
            )
        self.by_time = {int(entry["time_ns"]): entry for entry in entries}
        self.has_dense = any(entry.get("dense") for entry in entries)
        missing = [int(time) for time in frames.time_ns if int(time) not in self.by_time]
        if missing:
            raise TrainerError(
                f"{folder} lacks {len(missing)} of {len(frames)} frames, the first at {missing[0]} ns; "
                "dump this recording again"
            )

    def added_to(self, frames: Frames) -> Frames:
        """Frames of the recording with their coarse and dense depth."""
        entries = [self.by_time[int(time)] for time in frames.time_ns]
        coarse = np.stack([_planes(self.folder, self.camera, entry) for entry in entries])
        dense = None
        if self.has_dense:
            dense = np.stack([_planes(self.folder, self.camera, entry, "dense") for entry in entries])
        return replace(frames, coarse=coarse, dense=dense)


def with_coarse(frames: Frames, folder: Path) -> Frames:
    """Adds the coarse depth dumped from the same recording."""
    return CoarseDump(folder, frames).added_to(frames)


def read_dataset_dump(folder: Path) -> Frames:
    """Reads a dataset that `firmware-host perceive --dataset --dump` has resized to the robot's images."""
    camera, entries = _index(folder)
    if not entries or not all(entry["rgb"] for entry in entries):
        raise TrainerError(
            f"{folder} holds no images: it is the dump of a recording; give --recording RUN --coarse {folder}"
        )
    shape = (camera.height, camera.width)

    def truth(entry: dict[str, Any]) -> NDArray[np.uint16]:
        if not entry["truth"]:
            return np.zeros(shape, np.uint16)
        values: NDArray[np.uint16] = np.load(folder / f"{entry['name']}_truth.npy", allow_pickle=False)
        return values

    return Frames(
        camera,
        np.stack([np.load(folder / f"{entry['name']}_rgb.npy", allow_pickle=False) for entry in entries]),
        np.array([entry["t_world_camera"] for entry in entries], np.float64).reshape(-1, 4, 4),
        np.array([entry["time_ns"] for entry in entries], np.int64),
        # Frames of different test views belong to different runs.
        np.array([entry.get("view", 0) for entry in entries], np.int32),
        np.stack([truth(entry) for entry in entries]) if any(entry["truth"] for entry in entries) else None,
        np.stack([_planes(folder, camera, entry) for entry in entries]),
        _dense(folder, camera, entries),
    )
