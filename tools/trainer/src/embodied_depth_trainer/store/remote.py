"""A store in an object store, from which a training reads directly.

Its lists are copied when it is opened. The arrays of a shard are downloaded when a batch needs them, compared with
their digests, and kept by a `Cache`; of each, only its header is read before.

    CACHE/stores/ID/recipe.json, runs/   copies of the lists
    CACHE/stores/ID/pairs/, datasets/    what the training adds, as in a store on the disk
    CACHE/stores/ID/suspects             objects that had another digest when they were downloaded
"""

from __future__ import annotations

import hashlib
import re
from functools import partial
from io import FileIO

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.store.arrays import HEADER_BYTES, SUMS_FILE, ArrayFolder, DamagedError
from embodied_depth_trainer.store.bucket import (
    ReplacedError,
    StoredObject,
    list_objects,
    patient_pieces,
    read_object,
    read_part,
)
from embodied_depth_trainer.store.cache import Cache, DigestError, locked
from embodied_depth_trainer.store.store import RECIPE_FILE, Store

LIST = re.compile(r"runs/[^/]+\.json")
ID_DIGITS = 12


class RemoteStore(Store):
    """A store below a URL. What is added to it later is not seen."""

    def __init__(self, url: str, cache: Cache) -> None:
        self.url = url.rstrip("/")
        self.cache = cache
        self.objects = {found.path: found for found in list_objects(self.url)}
        if RECIPE_FILE not in self.objects:
            raise TrainerError(f"{url} is no store; copy one to it that `embodied-depth prepare` has made")
        folder = cache.folder / "stores" / hashlib.sha256(self.url.encode()).hexdigest()[:ID_DIGITS]
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._suspects = folder / "suspects"
        # Other processes of the training copy the same lists.
        with locked(folder / "lock"):
            for path in filter(self._is_list, self.objects):
                write_atomically(read_object(self.url, self.objects[path]), folder / path)
            for file in (folder / "runs").glob("*.json"):
                if f"runs/{file.name}" not in self.objects:
                    file.unlink()
        super().__init__(folder)
        self.suspects = set(self._suspects.read_text().splitlines()) if self._suspects.exists() else set()
        self.opened: dict[str, RemoteFolder] = {}

    @property
    def bytes(self) -> int:
        """Length of all objects in the folders that have been opened."""
        return sum(found.bytes for path, found in self.objects.items() if path.rpartition("/")[0] in self.opened)

    @property
    def largest(self) -> int:
        """Length of the longest object."""
        return max(found.bytes for found in self.objects.values())

    def has_shard(self, name: str) -> bool:
        return f"shards/{name}/{SUMS_FILE}" in self.objects

    def open_shard(self, name: str) -> ArrayFolder:
        return self._open(f"shards/{name}")

    def open_labels(self, name: str) -> ArrayFolder:
        return self._open(f"labels/{name}")

    def open_pairs(self, name: str) -> ArrayFolder:
        path = f"pairs/{name}"
        return self._open(path) if f"{path}/{SUMS_FILE}" in self.objects else super().open_pairs(name)

    def suspect(self, path: str) -> None:
        """Remembers that an object had another digest, so that the next training examines it before it begins."""
        with locked(self.folder / "lock"), self._suspects.open("a") as file:
            file.write(f"{path}\n")

    def _open(self, path: str) -> ArrayFolder:
        if path not in self.opened:
            self.opened[path] = RemoteFolder(self, path)
        return self.opened[path]

    @staticmethod
    def _is_list(path: str) -> bool:
        return path == RECIPE_FILE or LIST.fullmatch(path) is not None


class RemoteFolder(ArrayFolder):
    """A folder of arrays below the URL of a store."""

    def __init__(self, store: RemoteStore, below: str) -> None:
        self.store = store
        self.below = below
        # No such folder exists on the disk: it identifies this one.
        super().__init__(store.folder / below)

    def __str__(self) -> str:
        return f"{self.store.url}/{self.below}"

    def open(self, name: str) -> FileIO:
        listed = self._listed(name)
        expected = self._digest(name)
        try:
            return self.store.cache.open(expected, listed.bytes, partial(patient_pieces, self.store.url, listed))
        except DigestError as problem:
            self.store.suspect(listed.path)
            raise DamagedError(
                f"{self.path(name)} has the digest {str(problem)[:16]} instead of {expected[:16]}; the same command "
                "goes on without its shard, or with it if you copy the right file there before"
            ) from None
        except ReplacedError as problem:
            raise TrainerError(f"{problem}; the same command goes on with what is there now") from None

    def read(self, name: str) -> bytes:
        if name == SUMS_FILE:
            # The digests have no digest themselves; a frozen list has one of them (`train --only`).
            return read_object(self.store.url, self._listed(name))
        self.store.cache.check(self._digest(name))
        return super().read(name)

    def beginning(self, name: str) -> tuple[bytes, int]:
        listed = self._listed(name)
        if listed.bytes > self.store.cache.limit:
            raise TrainerError(
                f"{self.path(name)} has {listed.bytes:,} bytes, more than the whole cache of "
                f"{self.store.cache.limit:,}; give at least --cache-bytes {self.store.largest}"
            )
        kept = self.store.cache.find(self._digest(name))
        if kept is None:
            return read_part(self.store.url, listed, 0, min(HEADER_BYTES, listed.bytes)), listed.bytes
        with kept:
            return kept.read(HEADER_BYTES), listed.bytes

    def check(self) -> None:
        """Compares what the cache has of the folder. The other files are compared when they are downloaded, but for
        those that had another digest once: they are downloaded now."""
        for name, digest in self.digests.items():
            self.store.cache.check(digest)
            if f"{self.below}/{name}" in self.store.suspects:
                self.open(name).close()

    def _listed(self, name: str) -> StoredObject:
        try:
            return self.store.objects[f"{self.below}/{name}"]
        except KeyError:
            raise DamagedError(f"{self.path(name)} does not exist") from None

    def _digest(self, name: str) -> str:
        try:
            return self.digests[name]
        except KeyError:
            raise DamagedError(f"{self.path(SUMS_FILE)} has no digest of {name}") from None
