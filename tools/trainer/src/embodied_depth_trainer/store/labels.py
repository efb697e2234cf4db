"""Labels of the frames of one shard, and how they reach across the segments of a run.

The frames that vote on a label are up to `MAX_GAP` frames away, in this or a neighbouring segment (the halo); of these,
only frames at most a metre away that overlap are used (`data/labels.py`). Labels are named by their shard and its halo.
When a following segment arrives, only the last `MAX_GAP` frames are labelled again; the other labels are copied.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frame_set import joined
from embodied_depth_trainer.data.labels import EVERY, MAX_GAP, labels
from embodied_depth_trainer.data.teacher import Teacher, teach
from embodied_depth_trainer.data.teacher_options import TeacherOptions
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError, FolderWriter
from embodied_depth_trainer.store.dataset import open_shard
from embodied_depth_trainer.store.manifest import Entry

NAME_DIGITS = 8


@dataclass(frozen=True)
class LabelJob:
    """The labels of one shard."""

    shards: Path
    """Folder of all shards."""
    out: Path
    """Folder of all labels."""
    before: tuple[str, ...]
    """Shards before it that `MAX_GAP` frames reach, in their order."""
    own: str
    after: tuple[str, ...]
    old: str | None
    """Labels of this shard with a smaller halo."""
    teacher: Path | None = None
    teacher_options: TeacherOptions | None = None

    @property
    def name(self) -> str:
        return labels_name(self.own, self.before, self.after)


def labels_name(own: str, before: Sequence[str], after: Sequence[str]) -> str:
    """The name of a shard's labels in this halo."""
    # As `json.dumps` writes it, which takes longer.
    both = ", ".join("[" + ", ".join(f'"{name}"' for name in names) + "]" for names in (before, after))
    halo = hashlib.sha256(f"[{both}]".encode()).hexdigest()
    return f"{own}-{halo[:NAME_DIGITS]}"


def halo(entries: Sequence[Entry], place: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The shards before and after one that `MAX_GAP` frames reach."""
    return _reached(entries, range(place - 1, -1, -1))[::-1], _reached(entries, range(place + 1, len(entries)))


def _reached(entries: Sequence[Entry], places: range) -> tuple[str, ...]:
    found: list[str] = []
    frames = 0
    for place in places:
        if frames >= MAX_GAP:
            break
        entry = entries[place]
        assert entry.shard is not None
        found.append(entry.shard)
        frames += entry.frames
    return tuple(found)


def make_labels(job: LabelJob) -> str:
    """Labels the frames of a shard; returns the name of its labels."""
    kept = _kept(job)
    names = [*job.before, job.own, *job.after]
    try:
        shards = [open_shard(ArrayFolder(job.shards / name)) for name in names]
    except DamagedError as problem:
        raise DamagedError(f"{problem}; make it again with `embodied-depth prepare --check`") from None
    frames = joined(shards, [0] * len(shards))
    first = np.cumsum([0, *(len(shard) for shard in shards)])
    begin = int(first[len(job.before)])
    own = shards[len(job.before)]
    voters = [np.arange(start, start + len(shard), EVERY) for start, shard in zip(first, shards, strict=False)]
    targets = np.arange(begin + len(kept), begin + len(own))
    planes = labels(frames, targets, np.concatenate(voters))
    if job.teacher is not None and len(targets):
        teach(frames, targets, planes, _teacher(job.teacher, job.teacher_options or TeacherOptions()))
    writer = FolderWriter(job.out / job.name, len(own))
    if len(kept):
        writer.append("labels", kept)
    writer.append("labels", planes)
    # What follows the halo decides how much of these labels is kept later.
    after = int(first[-1]) - begin - len(own)
    writer.finish({"before": job.before, "after": job.after, "frames_after": after})
    return job.name


def _kept(job: LabelJob) -> NDArray[np.uint16]:
    """The labels of the first frames that the grown halo does not change."""
    nothing = np.empty(0, np.uint16)
    if job.old is None:
        return nothing
    try:
        old = ArrayFolder(job.out / job.old)
        old.check()
        planes = old.load("labels", np.uint16)
    except DamagedError:
        return nothing
    after = tuple(old.meta["after"])
    if tuple(old.meta["before"]) != job.before or job.after[: len(after)] != after:
        return nothing
    return planes[: max(0, len(planes) + old.meta["frames_after"] - MAX_GAP)]


@lru_cache(maxsize=1)
def _teacher(file: Path, options: TeacherOptions) -> Teacher:
    return Teacher(file, options)
