"""A version of a dataset: the list of the shards that a training reads, with their digests.

Shards and labels are named in it by the digests of their bytes, so a list is the same images, depth, poses and labels
on every computer. The version's name is a digest of the list; order and folders of the recordings do not change it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.store.store import Store

# The list, beside the checkpoint of every training.
DATASET_FILE = "dataset.json"
FORMAT_VERSION = 1
NAME_DIGITS = 16


@dataclass(frozen=True)
class ListedShard:
    """The shard of one segment, and its labels."""

    folder: str
    """Path of the run."""
    segment: str
    """Name of the segment's file."""
    frames: int
    shard: str
    digest: str
    """SHA-256 of the digests of its arrays."""
    labels: str | None
    """Name of its labels; `None` in a store without labels."""
    labels_digest: str | None

    def __str__(self) -> str:
        return f"{self.folder}/{self.segment} (shard {self.shard})"


@dataclass(frozen=True)
class ListedDump:
    """A dataset in files of another form, which is read into memory."""

    folder: str
    frames: int
    digest: str
    """SHA-256 of the digests of its files."""


@dataclass(frozen=True)
class DatasetVersion:
    """Shards and dumps to train on, in the order in which they are read."""

    recipes: tuple[str, ...]
    """Digests of the recipes that the shards were made by."""
    shards: tuple[ListedShard, ...]
    dumps: tuple[ListedDump, ...] = ()

    @property
    def name(self) -> str:
        """The first digits of the SHA-256 of all digests."""
        shards = sorted((shard.digest, shard.labels_digest or "") for shard in self.shards)
        content = [sorted(self.recipes), shards, sorted(dump.digest for dump in self.dumps)]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:NAME_DIGITS]

    @property
    def listed(self) -> list[ListedShard | ListedDump]:
        return [*self.shards, *self.dumps]

    @property
    def summary(self) -> dict[str, Any]:
        """What checkpoints and exported models say about it."""
        listed = self.listed
        return {
            "version": self.name,
            "shards": len(self.shards),
            "frames": sum(item.frames for item in listed),
            "runs": len({item.folder for item in listed}),
        }


def write_version(version: DatasetVersion, file: Path) -> None:
    plain = {"format_version": FORMAT_VERSION, "version": version.name, **asdict(version)}
    write_atomically(json.dumps(plain, indent=1).encode(), file)


def read_version(file: Path) -> DatasetVersion:
    """The list in a file, if it is what its name says."""
    try:
        plain = json.loads(file.read_text())
        shards = tuple(ListedShard(**shard) for shard in plain["shards"])
        found = DatasetVersion(tuple(plain["recipes"]), shards, tuple(ListedDump(**dump) for dump in plain["dumps"]))
        name = plain["version"]
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise TrainerError(
            f"{file} is no list of shards ({problem}); give the {DATASET_FILE} of a training, or one that "
            "`embodied-depth catalogue freeze` wrote"
        ) from None
    if found.name != name:
        raise TrainerError(
            f"{file} was changed: its digests are those of version {found.name}, not {name}; write it again"
        )
    return found


def remember(version: DatasetVersion, stores: Iterable[Store]) -> None:
    """Keeps the list in the stores, so that the segments of a model can be named later."""
    for store in stores:
        file = store.dataset(version.name)
        if not file.exists():
            write_version(version, file)


def remembered(name: str, stores: Sequence[Store]) -> DatasetVersion:
    """The list that a training or `catalogue freeze` has kept in one of the stores."""
    for file in (file for store in stores for file in (store.dataset(name), store.frozen(name))):
        if file.exists():
            return read_version(file)
    folders = ", ".join(str(store.folder) for store in stores)
    raise TrainerError(f"{folders} has no list of dataset {name}; give the --store that the model was trained on")


def dump_digest(folder: Path) -> str:
    """SHA-256 of the names and digests of all files of a dump."""
    whole = hashlib.sha256()
    for file in sorted(folder.iterdir()):
        with file.open("rb") as stream:
            whole.update(f"{hashlib.file_digest(stream, 'sha256').hexdigest()}  {file.name}\n".encode())
    return whole.hexdigest()
