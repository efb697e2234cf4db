"""Erases a recorded run from a store: everything that was made of it, and its objects if it is in an object store.

Lists of shards that trainings have read stay. They hold digests and no images, and say which models have learnt from
the run.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from embodied_depth_trainer.data.messages import SEGMENT_NAME
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import DamagedError, digest_in
from embodied_depth_trainer.store.bucket import StoredObject, delete_objects, list_objects
from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE
from embodied_depth_trainer.store.manifest import Run
from embodied_depth_trainer.store.prepare import unlisted
from embodied_depth_trainer.store.sources import is_encrypted, is_url
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import read_version


@dataclass(frozen=True)
class Erasure:
    """What is to be erased of one run."""

    store: Store
    run: Run
    folders: tuple[Path, ...]
    """Shards, labels and pairs that no other run has."""
    shared: tuple[str, ...]
    """Shards that stay, because other runs have the same segments."""
    objects: tuple[StoredObject, ...]
    """Of the run itself, if it is in an object store."""
    versions: dict[str, int]
    """Lists of shards that name erased ones, and how many of them, by their paths in the store."""
    unread: tuple[str, ...] = ()
    """Lists of shards that cannot be read."""
    unlisted: tuple[Path, ...] = ()
    """Folders that stay and that no list names: of earlier states of a run, of killed processes, or of parts."""

    def receipt(self) -> Iterator[str]:
        """A line for each thing that is erased: digest, bytes and name."""
        for found in self.objects:
            yield f"{found.etag or '-'}  {found.bytes}  {self.run.source}/{found.path}"
        for folder in self.folders:
            yield f"{_digest(folder)}  {_bytes(folder)}  {folder}"
        listed = self.store.run_file(self.run.source)
        yield f"-  {listed.stat().st_size}  {listed}"

    def erase(self) -> None:
        """Removes the objects first: while they are there, `prepare` makes the rest again. The list is removed last, so
        that an interrupted call can be repeated."""
        if self.objects:
            delete_objects(self.run.source, self.objects)
        try:
            for folder in self.folders:
                shutil.rmtree(folder)
            # It names the run, and is made again by the next query.
            (self.store.folder / CATALOGUE_FILE).unlink(missing_ok=True)
            self.store.run_file(self.run.source).unlink()
        except OSError as problem:
            raise TrainerError(f"not everything was erased: {problem}; the same command goes on") from problem


def erasure(store: Store, source: str, with_unlisted: bool = False) -> Erasure:
    """What is to be erased of the run at this absolute path or URL; `with_unlisted`: and what no list names, which may
    be of this run."""
    if not store.run_file(source).exists():
        raise TrainerError(
            f"{store.folder} holds no run {source}; give the directory or URL of one run, as `embodied-depth catalogue "
            f'query --store {store.folder} "SELECT DISTINCT folder FROM segments"` lists it'
        )
    kept, kept_labels = _named_by_others(store, source)
    run = store.run_of(source)
    shards = sorted({entry.shard for entry in run.entries.values() if entry.shard is not None})
    own = [shard for shard in shards if shard not in kept]
    folders = [store.shard(shard) for shard in own]
    # Of shared shards, too: the neighbours that voted on these labels are of this run.
    labels = {entry.labels for entry in run.entries.values() if entry.labels is not None} - kept_labels
    folders += [store.labels(name) for name in sorted(labels)]
    # Labels of other halos are left over from when the run was shorter.
    for folder in (store.folder / "labels", store.folder / "pairs"):
        found = (path for shard in own for path in sorted(folder.glob(f"{shard}-*")))
        folders += [path for path in found if path.name not in kept_labels]
    versions, unread = _versions(store, set(own))
    # A frozen list that cannot be read may name any of them.
    is_known = with_unlisted or not unread
    rest = [folder for folder in unlisted(store) if folder not in folders] if is_known else []
    folders += rest if with_unlisted else []
    return Erasure(
        store,
        run,
        tuple(folder for folder in dict.fromkeys(folders) if folder.is_dir()),
        tuple(shard for shard in shards if shard in kept),
        _objects(source) if is_url(source) else (),
        versions,
        tuple(unread),
        () if with_unlisted else tuple(rest),
    )


def _named_by_others(store: Store, source: str) -> tuple[set[str | None], set[str | None]]:
    """Shards and labels of all other runs. One list is in memory at a time."""
    shards: set[str | None] = set()
    labels: set[str | None] = set()
    for other in store.runs.values():
        if other.source != source:
            shards.update(entry.shard for entry in other.entries.values())
            labels.update(entry.labels for entry in other.entries.values())
    return shards, labels


def _objects(url: str) -> tuple[StoredObject, ...]:
    """All objects of a run. Refuses a URL below which there are several runs."""
    found = tuple(list_objects(url))
    deeper = [listed.path for listed in found if "/" in listed.path and _is_segment(listed)]
    if deeper:
        raise TrainerError(f"{url} holds other runs, for instance {deeper[0]}; nothing was erased; give one run")
    return found


def _is_segment(listed: StoredObject) -> bool:
    name = listed.path.rpartition("/")[2]
    return is_encrypted(listed) or re.fullmatch(SEGMENT_NAME, name) is not None


def _versions(store: Store, shards: set[str]) -> tuple[dict[str, int], list[str]]:
    """The lists that name these shards, with how many; and the lists that cannot be read."""
    found = {}
    unread = []
    for folder in ("datasets", "frozen"):
        for file in sorted((store.folder / folder).glob("*.json")):
            try:
                named = sum(listed.shard in shards for listed in read_version(file).shards)
            except TrainerError:
                unread.append(f"{folder}/{file.name}")
                continue
            if named:
                found[f"{folder}/{file.name}"] = named
    return found, unread


def _digest(folder: Path) -> str:
    try:
        return digest_in(folder)
    except DamagedError:
        return "-"


def _bytes(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
