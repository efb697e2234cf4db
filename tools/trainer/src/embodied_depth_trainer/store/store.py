"""The folders of a store:

    recipe.json          how everything in it was made
    runs/RUN.json        the segments of a run and their shards
    shards/NAME/         frames, coarse depth, poses, LiDAR lines, held-out marks of one segment
    labels/NAME/         labels of its frames
    pairs/NAME/          pairs of frames to train on
    datasets/NAME.json   lists of the shards that trainings have read
    frozen/NAME.json     lists whose shards and labels are kept
    downloads/           segments of an object store while they are read
    complete.npz         runs of which nothing was missing when they were last planned

Shards are named by the digests of their segment and of the recipe.
"""

from __future__ import annotations

import json
import os
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import process_name, write_atomically
from embodied_depth_trainer.store.arrays import ArrayFolder
from embodied_depth_trainer.store.manifest import Run, read_run, write_run
from embodied_depth_trainer.store.recipe import FORMAT_VERSION, Recipe, digest_of

RECIPE_FILE = "recipe.json"
# Hexadecimal digits of digests in names: 64 bits of a segment's, 32 of the few recipes'.
SEGMENT_DIGITS = 16
RECIPE_DIGITS = 8


class Runs(Mapping[str, Run]):
    """The lists of all runs by their names. Each is read when it is asked for, because memory should not hold those of
    a fleet's year; what is changed is kept by `Store.keep` only."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __getitem__(self, name: str) -> Run:
        file = self.folder / f"{name}.json"
        if not file.exists():
            raise KeyError(name)
        return read_run(file)

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(file.stem for file in self.folder.glob("*.json")))

    def __len__(self) -> int:
        return sum(1 for _ in self)


def name_hash(name: str) -> int:
    """A hash of 64 bits. Of 600,000 names, two have equal hashes in one of 100 million folders."""
    return int.from_bytes(blake2b(name.encode(), digest_size=8).digest(), "little", signed=True)


class Names:
    """What a folder holds, in eight bytes for each name. To ask the file system about each of a year's shards takes six
    times as long as to read the folder once."""

    def __init__(self, folder: Path) -> None:
        hashes: NDArray[np.int64] = np.empty(0, np.int64)
        if folder.is_dir():
            with os.scandir(folder) as files:
                hashes = np.fromiter((name_hash(file.name) for file in files), np.int64)
        hashes.sort()
        self.hashes = hashes
        self.view = memoryview(hashes.data)

    def __contains__(self, name: str | None) -> bool:
        if name is None:
            return False
        wanted = name_hash(name)
        place = bisect_left(self.view, wanted)
        return place < len(self.view) and self.view[place] == wanted

    def have(self, hashes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of these hashes are those of a name."""
        if not len(self.hashes):
            return np.zeros(len(hashes), np.bool_)
        places = np.searchsorted(self.hashes, hashes).clip(max=len(self.hashes) - 1)
        found: NDArray[np.bool_] = self.hashes[places] == hashes
        return found


class Store:
    """A store that exists."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self.recipe = json.loads((folder / RECIPE_FILE).read_text())
        except FileNotFoundError:
            raise TrainerError(
                f"{folder} is no store; make one with `embodied-depth prepare SOURCE --out {folder}`"
            ) from None
        if self.recipe.get("format_version") != FORMAT_VERSION:
            raise TrainerError(
                f"{folder} has format version {self.recipe.get('format_version')}, this trainer reads "
                f"{FORMAT_VERSION}; prepare the recordings again into another folder"
            )
        self.runs = Runs(folder / "runs")

    @staticmethod
    def create(folder: Path, recipe: Recipe) -> Store:
        """Opens the store of this recipe, or makes it."""
        file = folder / RECIPE_FILE
        if not file.exists():
            _begin(file, json.dumps(recipe.plain(), indent=1, sort_keys=True).encode())
        store = Store(folder)
        wanted = recipe.plain()
        keys = store.recipe.keys() | wanted.keys()
        different = {key: store.recipe.get(key) for key in sorted(keys) if store.recipe.get(key) != wanted.get(key)}
        if different:
            wanted = {key: wanted.get(key) for key in different}
            raise TrainerError(
                f"{folder} was made with {different}, now {wanted} is requested; give another --out, or the options "
                "and the firmware-host that it was made with"
            )
        return store

    @property
    def recipe_digest(self) -> str:
        return digest_of(self.recipe)

    @property
    def frames(self) -> int:
        """Number of frames in all shards."""
        return sum(entry.frames for run in self.runs.values() for entry in run.shards)

    @property
    def refused(self) -> int:
        """Number of segments that no known robot signed."""
        return sum(entry.refused is not None for run in self.runs.values() for entry in run.entries.values())

    def shard(self, name: str) -> Path:
        return self.folder / "shards" / name

    def labels(self, name: str) -> Path:
        return self.folder / "labels" / name

    @property
    def shard_names(self) -> Names:
        return Names(self.folder / "shards")

    @property
    def labels_names(self) -> Names:
        return Names(self.folder / "labels")

    def pairs(self, name: str) -> Path:
        return self.folder / "pairs" / name

    def has_shard(self, name: str) -> bool:
        return self.shard(name).is_dir()

    def open_shard(self, name: str) -> ArrayFolder:
        return ArrayFolder(self.shard(name))

    def open_labels(self, name: str) -> ArrayFolder:
        return ArrayFolder(self.labels(name))

    def open_pairs(self, name: str) -> ArrayFolder:
        return ArrayFolder(self.pairs(name))

    @property
    def downloads(self) -> Path:
        return self.folder / "downloads"

    def dataset(self, name: str) -> Path:
        return self.folder / "datasets" / f"{name}.json"

    def frozen(self, name: str) -> Path:
        return self.folder / "frozen" / f"{name}.json"

    def run_of(self, source: str) -> Run:
        """The run at this absolute path or URL; an empty one if it is new."""
        return self.runs.get(Run.name_of(source)) or Run(source)

    def run_file(self, source: str) -> Path:
        """The list of the run at this absolute path or URL."""
        return self.folder / "runs" / f"{Run.name_of(source)}.json"

    def keep(self, run: Run) -> None:
        """Writes the list of a run's segments."""
        write_run(run, self.run_file(run.source))


def is_store(folder: Path) -> bool:
    return (folder / RECIPE_FILE).exists()


def restarts_of(folder: Path) -> int | None:
    """The `restart_every` of an existing store."""
    every: int | None = Store(folder).recipe.get("restart_every")
    return every


def _begin(file: Path, recipe: bytes) -> None:
    """Writes the recipe of a new store. Several processes may begin the same store at the same moment: the first one
    wins, and those with another recipe refuse to go on."""
    own = file.with_name(f"{file.name}.{process_name()}")
    write_atomically(recipe, own)
    with suppress(FileExistsError):
        os.link(own, file)
    own.unlink()


def shard_name(segment_digest: str, recipe_digest: str) -> str:
    return f"{segment_digest[:SEGMENT_DIGITS]}-{recipe_digest[:RECIPE_DIGITS]}"


def past_of(stores: Sequence[Store]) -> PastFrames | None:
    """The past frames that the coarse depth of all stores comes from; `None` if it is the robot's own."""
    found = {json.dumps(store.recipe["past"]) for store in stores}
    if len(found) > 1:
        raise TrainerError(f"the stores have coarse depth from different past frames, {found}; train on one of them")
    past = stores[0].recipe["past"] if stores else None
    return None if past is None else PastFrames(**past)
