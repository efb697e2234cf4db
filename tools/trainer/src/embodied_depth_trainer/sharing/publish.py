"""A dataset as a folder to upload: a store that holds the shards of one version and nothing else."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.store.listing import segments_in
from embodied_depth_trainer.store.manifest import Entry, Run, write_run
from embodied_depth_trainer.store.store import RECIPE_FILE, Store
from embodied_depth_trainer.store.version import DatasetVersion, ListedShard, write_version


def stage(version: DatasetVersion, stores: Sequence[Store], card: str, folder: Path) -> DatasetVersion:
    """Fills an empty folder with links to the files of the shards. Returns the version as the folder names it."""
    if version.dumps or len(version.recipes) != 1:
        raise TrainerError(
            f"dataset {version.name} has {len(version.dumps)} dumps and {len(version.recipes)} recipes, and only "
            "shards of one recipe can be uploaded; freeze a list of one store with `embodied-depth catalogue freeze`"
        )
    for segment in segments_in(version, stores):
        for found in filter(None, segment.open()):
            # Nothing is published that is not what was written.
            found.check()
            _link(found.folder, folder / found.folder.parent.name / found.folder.name)
    public = replace(
        version, shards=tuple(replace(shard, folder=public_name(shard.folder)) for shard in version.shards)
    )
    store = next(store for store in stores if store.recipe_digest in version.recipes)
    write_atomically(json.dumps(store.recipe, indent=1, sort_keys=True).encode(), folder / RECIPE_FILE)
    for run in _runs(version, stores):
        write_run(run, folder / "runs" / f"{run.source}.json")
    write_version(public, folder / "frozen" / f"{version.name}.json")
    write_atomically(card.encode(), folder / "README.md")
    return public


def public_name(source: str) -> str:
    """The name of a run for others. Paths may name a person, a flat or a bucket."""
    return f"run-{hashlib.sha256(source.encode()).hexdigest()[:12]}"


def _link(source: Path, to: Path) -> None:
    to.mkdir(parents=True)
    for file in source.iterdir():
        (to / file.name).symlink_to(file.resolve())


def _runs(version: DatasetVersion, stores: Sequence[Store]) -> list[Run]:
    """The lists of the segments of the version."""
    known = {entry.shard: entry for store in stores for run in store.runs.values() for entry in run.entries.values()}
    runs: dict[str, Run] = defaultdict(lambda: Run(""))
    for shard in version.shards:
        run = runs[public_name(shard.folder)]
        run.source = public_name(shard.folder)
        run.entries[shard.segment] = _entry(shard, known.get(shard.shard))
    return list(runs.values())


def _entry(shard: ListedShard, known: Entry | None) -> Entry:
    """A segment as its store knows it, with the labels of the version."""
    # The store may have forgotten a segment whose shard a frozen list keeps.
    entry = known or Entry(shard.segment, 0, 0, "", shard.shard, shard.frames)
    return replace(entry, file=shard.segment, labels=shard.labels)
