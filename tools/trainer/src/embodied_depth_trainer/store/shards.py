"""Makes the shard of one segment: a function of the segment's bytes and of the recipe, and of nothing else.

A segment can be read without the others of its run, so each is made on its own, in any order and on any computer. The
price is that coarse depth begins anew in each: the engine needs some frames until it has a baseline again.
"""

from __future__ import annotations

import hashlib
import shlex
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from embodied_depth_trainer.data.coarse_depth import CoarseDump
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.past_frames import with_past_coarse
from embodied_depth_trainer.data.recording import Segment, read_segment
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError, FolderWriter
from embodied_depth_trainer.store.bucket import ReplacedError
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.manifest import Entry
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.sources import RecordedSegment
from embodied_depth_trainer.store.store import shard_name
from embodied_depth_trainer.store.trust import checked

# Frames that are reduced and written at once.
CHUNK = 32
# What a shard keeps of the segment's header, for the catalogue.
KEPT_OF_SEGMENT = ("segment", "first_tick", "zero_unix_ns")
KEPT_OF_RUN = ("written_by", "scene", "policy", "seed", "depth_source", "model_digest")
LOG_LINES = 8


@dataclass(frozen=True)
class ShardJob:
    """The shard of one segment."""

    segment: RecordedSegment
    shards: Path
    """Folder of all shards."""
    downloads: Path
    """Folder for a segment that is not on the disk."""
    recipe: Recipe
    robot: Path | None
    """Path of firmware-host."""
    known_robots: KnownRobots | None = None
    """The robots whose segments are accepted; `None`: signatures are not checked."""


def make_shard(job: ShardJob) -> Entry | None:
    """Makes the shard unless it exists. A segment that cannot be read, or that no known robot signed, gives an entry
    without a shard; an object that was replaced after it was listed gives none."""
    try:
        with job.segment.on_disk(job.downloads) as file:
            return _shard_of(job, file)
    except ReplacedError:
        return None


def _shard_of(job: ShardJob, file: Path) -> Entry:
    try:
        entry = job.segment.entry()
        with file.open("rb") as stream:
            entry = replace(entry, digest=hashlib.file_digest(stream, "sha256").hexdigest())
        if job.known_robots is not None:
            entry = checked(entry, file, job.known_robots)
    except OSError as problem:
        raise TrainerError(f"cannot read {file}: {problem}; check the file and its permissions") from problem
    if entry.refused is not None:
        return entry
    name = shard_name(entry.digest, job.recipe.digest)
    meta = _existing(job.shards / name)
    if meta is None:
        try:
            segment = read_segment(file)
        except TrainerError as problem:
            return replace(entry, damage=str(problem).replace(str(file), str(job.segment)))
        meta = _made(job, file, segment, entry)
    return replace(entry, shard=name, frames=meta["frames"], damage=meta["damage"])


def _existing(folder: Path) -> dict[str, Any] | None:
    """What describes the shard. What is left of a damaged one is removed."""
    # Between a failed attempt to open it and the removal, another process could complete it.
    if not folder.exists():
        return None
    try:
        return ArrayFolder(folder).meta
    except DamagedError:
        shutil.rmtree(folder, ignore_errors=True)
        return None


def _made(job: ShardJob, file: Path, segment: Segment, entry: Entry) -> dict[str, Any]:
    """Writes the shard and returns what describes it."""
    writer = FolderWriter(job.shards / shard_name(entry.digest, job.recipe.digest), len(segment.frames))
    try:
        for part in _parts(job, file, segment.frames, writer.partial):
            _append(writer, part)
        meta = _described(segment, part, job.recipe)
        if not job.segment.is_known(entry):
            raise TrainerError(f"{job.segment} was changed while it was read; prepare it again")
        writer.finish(meta)
    except BaseException:
        writer.abandon()
        raise
    return meta


def _parts(job: ShardJob, file: Path, frames: Frames, scratch: Path) -> Iterator[Frames]:
    """The frames as the shard holds them, some at a time."""
    recipe = job.recipe
    if recipe.past is not None:
        yield with_past_coarse(frames.reduced_to(recipe.size) if recipe.size else frames, recipe.past)
        return
    chunks = [slice(first, first + CHUNK) for first in range(0, len(frames), CHUNK)]
    with _dump(job, file, frames, scratch) as dump:
        for chunk in chunks:
            part = frames.at(chunk)
            part = part if dump is None else dump.added_to(part)
            yield part.reduced_to(recipe.size) if recipe.size else part


@contextmanager
def _dump(job: ShardJob, file: Path, frames: Frames, scratch: Path) -> Iterator[CoarseDump | None]:
    """The coarse and dense depth that the robot's own engine computes of the segment, while the context lasts."""
    if job.recipe.coarse != "robot":
        yield None
        return
    assert job.robot is not None
    folder = scratch.with_suffix(".coarse")
    # A killed process with the same number may have left it, and `perceive` replaces no results of another run.
    shutil.rmtree(folder, ignore_errors=True)
    try:
        folder.mkdir(mode=0o700)
        command = [str(job.robot), "perceive", "--recording", str(file)]
        if job.recipe.restart_every is not None:
            command += ["--restart-every", str(job.recipe.restart_every)]
        call([*command, "--out", str(folder / "look"), "--dump", str(folder / "dump")], folder / "perceive.log")
        yield CoarseDump(folder / "dump", frames)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _append(writer: FolderWriter, part: Frames) -> None:
    assert part.lidar is not None
    assert part.held_out is not None
    writer.append("rgb", part.rgb)
    if part.coarse is not None:
        writer.append("coarse", part.coarse)
    if part.dense is not None:
        writer.append("dense", part.dense)
    writer.append("lidar", part.lidar)
    writer.append("pose", part.t_world_camera)
    writer.append("time", part.time_ns)
    writer.append("held_out", part.held_out)


def _described(segment: Segment, part: Frames, recipe: Recipe) -> dict[str, Any]:
    header = segment.header
    run = header["run"]
    assert segment.frames.lidar is not None
    assert segment.frames.held_out is not None
    return {
        "frames": len(segment.frames),
        "camera": asdict(part.camera),
        "coarse": part.coarse is not None,
        "dense": part.dense is not None,
        "has_lidar": bool(segment.frames.lidar.any()),
        "damage": segment.damage,
        "recipe": recipe.digest,
        "recorded": {key: header.get(key) for key in KEPT_OF_SEGMENT}
        | {key: run.get(key) for key in KEPT_OF_RUN}
        # A recording without an identity keeps the shard that earlier versions made of it.
        | ({"identity": run["identity"]} if "identity" in run else {}),
        "events": segment.events,
        "first_time_ns": int(segment.frames.time_ns[0]),
        "held_out": int(np.count_nonzero(segment.frames.held_out)),
        "length_m": _length_m(segment.frames),
    }


def _length_m(frames: Frames) -> float:
    """The length of the path."""
    return float(np.linalg.norm(np.diff(frames.t_world_camera[:, :3, 3], axis=0), axis=1).sum())


def call(command: Sequence[str], log: Path) -> None:
    """Runs the robot's program."""
    with log.open("wb") as stream:
        try:
            done = subprocess.run(command, stdout=stream, stderr=stream, check=False)
        except OSError as problem:
            raise TrainerError(f"cannot run {command[0]}: {problem}; give --firmware-host FILE") from problem
    if done.returncode != 0:
        lines = "\n".join(log.read_text(errors="replace").splitlines()[-LOG_LINES:])
        raise TrainerError(f"`{shlex.join(command)}` failed with {done.returncode}; its last lines are\n{lines}")
