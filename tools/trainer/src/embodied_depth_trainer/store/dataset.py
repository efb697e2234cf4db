"""The frames of shards as one set to train on. Poses are in memory, planes are read from the disk as they are used."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from embodied_depth_trainer.data.coarse_depth import read_dataset_dump
from embodied_depth_trainer.data.frame_set import FrameSet, LazyFrames, joined
from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError
from embodied_depth_trainer.store.manifest import Entry
from embodied_depth_trainer.store.store import Store


@dataclass(frozen=True)
class Part:
    """Consecutive frames of a dataset: a shard, or a dump in memory."""

    frames: FrameSet
    store: Store | None = None
    run: str = ""
    """Path of the list of the run's segments."""
    name: str = ""
    """Name of the shard."""
    digest: str = ""
    """SHA-256 of the digests of its arrays."""
    has_lidar: bool = False


@dataclass(frozen=True)
class Dataset:
    """Frames to train on, and where they come from."""

    frames: LazyFrames
    parts: Sequence[Part]
    every: int
    """Every `every`th frame of a shard is used."""

    @property
    def has_lidar(self) -> bool:
        return any(part.has_lidar for part in self.parts)

    @property
    def digests(self) -> list[str]:
        """The digests of all shards."""
        return [part.digest for part in self.parts if part.store is not None]


def open_dataset(
    stores: Sequence[Store],
    dumps: Sequence[Path] = (),
    size: tuple[int, int] | None = None,
    every: int = 1,
    checked: set[str] | None = None,
) -> Dataset:
    """All shards of the stores, and dumps of datasets, whose images are reduced to `size`. A shard whose digests are
    not those that were written is named and left out; those in `checked` are not read again."""
    parts = [part for store in stores for part in _shards(store, every, checked if checked is not None else set())]
    for folder in dumps:
        frames = read_dataset_dump(folder)
        parts.append(Part(frames.reduced_to(size) if size else frames))
    if not parts:
        raise TrainerError("there is no shard to train on; prepare recordings with `embodied-depth prepare`")
    return Dataset(joined([part.frames for part in parts], _first_runs(parts)), parts, every)


def _first_runs(parts: Sequence[Part]) -> list[int]:
    """The number of each part's first run. The shards of one run share it, because they share an odometry frame; a dump
    has as many runs as views."""
    known: dict[str, int] = {}
    found = []
    following = 0
    for part in parts:
        first = known.setdefault(part.run, following) if part.store is not None else following
        found.append(first)
        following = max(following, first + int(part.frames.run.max(initial=0)) + 1)
    return found


def open_shard(folder: ArrayFolder, labels: ArrayFolder | None = None, every: int = 1) -> LazyFrames:
    """The frames of one shard."""
    poses = folder.load("pose", np.float64, every)
    return LazyFrames(
        Intrinsics(**folder.meta["camera"]),
        folder.array("rgb", np.uint8, every),
        poses,
        folder.load("time", np.int64, every),
        np.zeros(len(poses), np.int32),
        folder.array("coarse", np.uint16, every) if folder.meta["coarse"] else None,
        folder.array("dense", np.uint16, every) if folder.meta["dense"] else None,
        None if labels is None else labels.array("labels", np.uint16, every),
        folder.array("lidar", np.uint16, every),
        folder.load("held_out", np.bool_, every),
    )


def _shards(store: Store, every: int, checked: set[str]) -> list[Part]:
    """The shards of a store that are what was written. A segment in two runs is used once."""
    wanted: dict[str, tuple[str, Entry]] = {}
    for name, run in store.runs.items():
        for entry in run.shards:
            wanted.setdefault(entry.shard or "", (name, entry))
    parts = []
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        opened = threads.map(partial(_part, store, every, checked), wanted.values())
        for part in tqdm(opened, total=len(wanted), unit="shard", desc="checking", disable=None):
            if isinstance(part, Part):
                parts.append(part)
            else:
                print(f"left out: {part}; `embodied-depth prepare --check` makes it again", file=sys.stderr)
    return parts


def _part(store: Store, every: int, checked: set[str], listed: tuple[str, Entry]) -> Part | DamagedError:
    """A shard that is listed in a run, with its labels, or what is wrong with it."""
    run, entry = listed
    name = entry.shard or ""
    try:
        folder = ArrayFolder(store.shard(name))
        labels = ArrayFolder(store.labels(entry.labels or f"{name}-none")) if store.recipe["labels"] else None
        for part in (folder, labels):
            if part is not None and str(part.folder) not in checked:
                part.check()
                checked.add(str(part.folder))
        frames = open_shard(folder, labels, every)
    except DamagedError as problem:
        return problem
    return Part(frames, store, str(store.folder / run), name, folder.digest, folder.meta["has_lidar"])
