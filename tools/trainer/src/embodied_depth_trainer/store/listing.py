"""The segments whose shards are to be read: all of a store, or those of a frozen list."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError
from embodied_depth_trainer.store.catalogue import IN_ORDER, query
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import DatasetVersion, ListedShard

# The columns that a list of shards is made of, in the order of `ListedShard`.
CHOSEN = (
    "SELECT folder, segment, frames, shard, digest, labels, labels_digest FROM segments "
    f"WHERE shard IN (SELECT unnest(?)) ORDER BY {IN_ORDER}"
)
# Problems that an error text names; more of them are counted.
NAMED = 20


@dataclass(frozen=True)
class StoredSegment:
    """A segment and where its shard is."""

    store: Store
    folder: str
    """Path of its run."""
    file: str
    shard: str
    labels: str | None

    def open(self) -> tuple[ArrayFolder, ArrayFolder | None]:
        """Its shard and its labels."""
        shard = self.store.open_shard(self.shard)
        if not self.store.recipe["labels"]:
            return shard, None
        # A preparation that was interrupted leaves shards without labels.
        return shard, self.store.open_labels(self.labels or f"{self.shard}-none")

    def listed(self) -> ListedShard:
        """Its line in a list of shards, with the digests that were written."""
        shard, labels = self.open()
        return ListedShard(
            self.folder,
            self.file,
            int(shard.meta["frames"]),
            self.shard,
            shard.digest,
            self.labels if labels is not None else None,
            labels.digest if labels is not None else None,
        )


def segments_of(store: Store) -> list[StoredSegment]:
    """All segments of a store that have a shard; a segment in two runs once."""
    found: dict[str, StoredSegment] = {}
    for run in store.runs.values():
        for entry in run.shards:
            assert entry.shard is not None
            found.setdefault(entry.shard, StoredSegment(store, run.source, entry.file, entry.shard, entry.labels))
    return list(found.values())


def segments_in(version: DatasetVersion, stores: Sequence[Store]) -> list[StoredSegment]:
    """The segments of a list, in its order; refuses a list of which something is missing or different."""
    found, problems = [], []
    for wanted in version.shards:
        store = next((store for store in stores if store.has_shard(wanted.shard)), None)
        if store is None:
            problems.append(f"{wanted} is missing")
            continue
        segment = StoredSegment(store, wanted.folder, wanted.segment, wanted.shard, wanted.labels)
        try:
            if segment.listed() == wanted:
                found.append(segment)
            else:
                problems.append(f"{wanted} or its labels have other digests")
        except DamagedError as problem:
            problems.append(f"{wanted}: {problem}")
    refuse(version, problems)
    return found


def refuse(version: DatasetVersion, problems: Sequence[str]) -> None:
    """Raises an error that names the problems, if there are any."""
    if problems:
        more = f"\nand {len(problems) - NAMED} more" if len(problems) > NAMED else ""
        raise TrainerError(
            f"{len(problems)} of the {len(version.shards)} shards of dataset {version.name} cannot be used; prepare "
            "their recordings again with the same recipe, repair the store with `embodied-depth prepare --check`, or "
            "freeze another list:\n" + "\n".join(problems[:NAMED]) + more
        )


def freeze(store: Store, shards: Iterable[str]) -> DatasetVersion:
    """The list of these shards of a store, in the order of runs and segments."""
    names = set(shards)
    # A segment in two runs is listed once.
    chosen: dict[str, ListedShard] = {}
    for row in query(store.folder, CHOSEN, [list(names)]).rows:
        shard = ListedShard(*row)
        chosen.setdefault(shard.shard, shard)
    problems = _incomplete(store, chosen.values())
    if problems:
        raise TrainerError(
            f"{len(problems)} shards cannot be frozen; make them with `embodied-depth prepare --check`: "
            + ", ".join(problems[:NAMED])
        )
    missing = sorted(names - chosen.keys())
    if missing or not chosen:
        which = ", ".join(missing) if missing else "that was chosen"
        raise TrainerError(f"{store.folder} has no shard {which}; freeze shards of its table `segments`")
    return DatasetVersion((store.recipe_digest,), tuple(chosen.values()))


def _incomplete(store: Store, chosen: Iterable[ListedShard]) -> list[str]:
    """What is missing of these shards. Their bytes are compared by the training that reads them."""
    shards, labels = store.shard_names, store.labels_names
    has_labels = store.recipe["labels"]
    found = []
    for shard in chosen:
        if shard.shard not in shards:
            found.append(f"{store.shard(shard.shard)} is missing")
        elif has_labels and (shard.labels_digest is None or shard.labels not in labels):
            found.append(f"{shard} has no labels")
    return found
