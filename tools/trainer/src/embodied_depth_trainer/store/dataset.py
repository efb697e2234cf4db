"""The frames of shards as one set to train on. Poses are in memory, planes are read from the disk as they are used."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from embodied_depth_trainer.data.coarse_depth import read_dataset_dump
from embodied_depth_trainer.data.frame_set import FrameSet, LazyFrames, joined
from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError
from embodied_depth_trainer.store.listing import StoredSegment, refuse, segments_in, segments_of
from embodied_depth_trainer.store.remote import RemoteStore
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import (
    DATASET_FILE,
    DatasetVersion,
    ListedDump,
    ListedShard,
    dump_digest,
    remember,
    write_version,
)

# Shards in an object store that are opened at a time: they wait for answers and not for the processor.
REQUESTS = 16


@dataclass(frozen=True)
class Part:
    """Consecutive frames of a dataset: a shard, or a dump in memory."""

    frames: FrameSet
    listed: ListedShard | ListedDump
    store: Store | None = None
    has_lidar: bool = False

    @property
    def run(self) -> str:
        """The run in its store. Runs of two stores are not related."""
        return f"{self.store.folder if self.store else ''}:{self.listed.folder}"

    @property
    def name(self) -> str:
        """Name of the shard."""
        return self.listed.shard if isinstance(self.listed, ListedShard) else ""

    @property
    def digest(self) -> str:
        return self.listed.digest


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
    def stores(self) -> list[Store]:
        """The stores of its shards."""
        return list({part.store.folder: part.store for part in self.parts if part.store is not None}.values())

    @property
    def version(self) -> DatasetVersion:
        """The list of what is read."""
        listed = [part.listed for part in self.parts]
        return DatasetVersion(
            tuple(sorted({store.recipe_digest for store in self.stores})),
            tuple(item for item in listed if isinstance(item, ListedShard)),
            tuple(item for item in listed if isinstance(item, ListedDump)),
        )

    @property
    def summary(self) -> dict[str, Any]:
        """What checkpoints and exported models say about it."""
        return {**self.version.summary, "every": self.every}


def open_dataset(
    stores: Sequence[Store],
    dumps: Sequence[Path] = (),
    size: tuple[int, int] | None = None,
    every: int = 1,
    checked: set[str] | None = None,
    only: DatasetVersion | None = None,
) -> Dataset:
    """All shards of the stores, and dumps of datasets, whose images are reduced to `size`. A shard whose digests are
    not those that were written is named and left out; those in `checked` are not read again. With `only`, the dataset
    is this version, and what is missing or damaged is refused."""
    checked = set() if checked is None else checked
    parts = _all_shards(stores, every, checked) if only is None else _only_shards(only, stores, every, checked)
    read = [_dump(folder, size) for folder in dumps]
    if only is not None and {part.listed.digest for part in read} != {dump.digest for dump in only.dumps}:
        named = ", ".join(dump.folder for dump in only.dumps) or "no dump"
        raise TrainerError(
            f"dataset {only.name} has {named} of --dataset, with the same bytes; give these and no other"
        )
    parts += read
    if not parts:
        raise TrainerError("there is no shard to train on; prepare recordings with `embodied-depth prepare`")
    return Dataset(joined([part.frames for part in parts], _first_runs(parts)), parts, every)


def record_version(dataset: Dataset, out: Path) -> None:
    """Writes the list of what a training reads beside its checkpoint and into the stores."""
    version = dataset.version
    write_version(version, out / DATASET_FILE)
    remember(version, dataset.stores)


def _dump(folder: Path, size: tuple[int, int] | None) -> Part:
    frames = read_dataset_dump(folder)
    listed = ListedDump(str(folder.resolve()), len(frames), dump_digest(folder))
    return Part(frames.reduced_to(size) if size else frames, listed)


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


def _all_shards(stores: Sequence[Store], every: int, checked: set[str]) -> list[Part]:
    """The shards of the stores that are what was written."""
    opened = _opened([segment for store in stores for segment in segments_of(store)], every, checked)
    is_remote = any(isinstance(store, RemoteStore) for store in stores)
    advice = "copy its files there again" if is_remote else "`embodied-depth prepare --check` makes it again"
    for problem in opened:
        if isinstance(problem, DamagedError):
            print(f"left out: {problem}; {advice}", file=sys.stderr)
    return [part for part in opened if isinstance(part, Part)]


def _only_shards(version: DatasetVersion, stores: Sequence[Store], every: int, checked: set[str]) -> list[Part]:
    """The shards of a version, all of them."""
    opened = _opened(segments_in(version, stores), every, checked)
    refuse(version, [str(problem) for problem in opened if isinstance(problem, DamagedError)])
    return [part for part in opened if isinstance(part, Part)]


def _opened(segments: Sequence[StoredSegment], every: int, checked: set[str]) -> list[Part | DamagedError]:
    """The shards, in their order, or what is wrong with them."""
    is_remote = any(isinstance(segment.store, RemoteStore) for segment in segments)
    with ThreadPoolExecutor(REQUESTS if is_remote else os.cpu_count()) as threads:
        opened = threads.map(partial(_part, every, checked), segments)
        return list(tqdm(opened, total=len(segments), unit="shard", desc="checking", disable=None))


def _part(every: int, checked: set[str], segment: StoredSegment) -> Part | DamagedError:
    """A shard with its labels, or what is wrong with it."""
    try:
        shard, labels = segment.open()
        for folder in (shard, labels):
            if folder is not None and str(folder.folder) not in checked:
                folder.check()
                checked.add(str(folder.folder))
        frames = open_shard(shard, labels, every)
        listed = segment.listed()
    except DamagedError as problem:
        return problem
    return Part(frames, listed, segment.store, shard.meta["has_lidar"])
