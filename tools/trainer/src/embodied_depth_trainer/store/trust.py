"""Which segments of a store may be trained on, given the robots that are known (`prepare --robots`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.manifest import Entry
from embodied_depth_trainer.store.signature import check, unknown
from embodied_depth_trainer.store.signature_record import UntrustedError
from embodied_depth_trainer.store.store import Store

NOT_CHECKED = "its shard was made without --robots, so its signature was never checked"


def checked(entry: Entry, file: Path, robots: KnownRobots) -> Entry:
    """The entry with who signed the file, or with why it is refused."""
    try:
        record = check(file, robots)
    except UntrustedError as problem:
        return replace(entry, refused=str(problem), refused_with=robots.digest)
    return replace(entry, signed_by=record.robot, signed_digest=record.digest, previous=record.previous)


def is_decided(entry: Entry, robots: KnownRobots | None) -> bool:
    """Whether these robots decide about the entry without another look at its segment. A signature that was valid once
    stays so; one that was refused is looked at again with other robots."""
    if robots is None:
        return entry.refused is None
    return entry.signed_by is not None or (entry.refused is not None and entry.refused_with == robots.digest)


def review(store: Store, robots: KnownRobots) -> dict[str, str]:
    """Refuses all shards of the store that none of these robots signed, and accepts those again that one signed;
    returns what is newly refused, and why.

    All runs are reviewed, because a segment whose shard was made without a check may be gone from its source.
    """
    found = {}
    for run in store.runs.values():
        reviewed = {entry.file: _reviewed(entry, robots) for entry in run.entries.values() if entry.shard is not None}
        changed = {file: entry for file, entry in reviewed.items() if entry != run.entries[file]}
        if changed:
            run.entries.update(changed)
            store.keep(run)
        found.update({f"{run.source}/{file}": entry.refused for file, entry in changed.items() if entry.refused})
    return found


def _reviewed(entry: Entry, robots: KnownRobots) -> Entry:
    if entry.signed_by is None:
        return replace(entry, refused=NOT_CHECKED)
    return replace(entry, refused=None if entry.signed_by in robots.names else unknown(entry.signed_by))
