"""Makes the store of a fleet's year as metadata: every segment refers to the same few real ones.

A segment is another name of a real recording, and a shard a link to a folder whose arrays are those of a real shard.
Only the lists of segments, the links and what describes a shard (`meta.json`, for each run) are written.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import cycle
from pathlib import Path
from typing import Any

from embodied_depth_trainer.store.arrays import META_FILE, SUMS_FILE
from embodied_depth_trainer.store.labels import LabelJob, halo
from embodied_depth_trainer.store.manifest import Entry, Run
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store, shard_name

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
YEAR = timedelta(days=365)
# Every third home has stairs.
SCENE = "builtin:apartment?seed={home}&stairs={stairs}"
DIGITS = 4


@dataclass(frozen=True)
class Year:
    """How much the robots of a fleet record in a year."""

    robots: int = 100
    runs: int = 100
    """Of each robot, evenly over the year."""
    segments: int = 60
    """Of each run, a minute each."""

    @property
    def total(self) -> int:
        return self.robots * self.runs * self.segments


def make_year(year: Year, real: Store, recordings: list[Path], out: Path) -> tuple[Path, Store]:
    """Writes the pulled folder and the store whose segments refer to those of a real store; returns both."""
    recipe = Recipe(**{key: value for key, value in real.recipe.items() if key != "format_version"})
    store = Store.create(out / "store", recipe)
    for name in ("runs", "shards", "labels", "real"):
        (store.folder / name).mkdir(exist_ok=True)
    (example,) = real.runs.values()
    (store.folder / "real" / "labels").symlink_to(real.labels(example.shards[0].labels or "").resolve())
    # A file can have 65,000 names, so each robot has a copy.
    for robot in range(year.robots):
        copies = [Path(shutil.copy(file, out / f"{robot:03d}-{file.name}")) for file in recordings]
        for run in range(year.runs):
            folder = out / "pulled" / f"robot_{robot:03d}" / f"run_{run:04d}"
            _make_run(year, robot, run, folder, store, real, list(zip(example.shards, copies, strict=True)))
    return out / "pulled", store


def _make_run(
    year: Year, robot: int, number: int, folder: Path, store: Store, real: Store, models: list[tuple[Entry, Path]]
) -> None:
    folder.mkdir(parents=True)
    name = f"{robot:03d}-{number:04d}"
    entries = []
    described = [_described(year, robot, number, real, model, store.folder / "real") for model, _ in models]
    for segment, ((model, recording), shard) in zip(
        range(year.segments), cycle(zip(models, described, strict=True)), strict=False
    ):
        file = folder / f"recording_{segment:0{DIGITS}d}.mcap"
        os.link(recording, file)
        state = file.stat()
        digest = hashlib.sha256(f"{name}-{segment}".encode()).hexdigest()
        entry = Entry(
            file.name,
            state.st_size,
            state.st_mtime_ns,
            digest,
            shard_name(digest, store.recipe_digest),
            model.frames,
            model.damage,
        )
        _link(shard, store.shard(entry.shard or ""))
        entries.append(entry)
    run = Run(str(folder.resolve()), {entry.file: entry for entry in entries})
    if store.recipe["labels"]:
        _label(run, entries, store, store.folder / "real" / "labels")
    _write(run, store)


def _label(run: Run, entries: list[Entry], store: Store, labels: Path) -> None:
    for place, entry in enumerate(entries):
        before, after = halo(entries, place)
        name = LabelJob(Path(), Path(), before, entry.shard or "", after, None).name
        run.entries[entry.file] = replace(entry, labels=name)
        _link(labels, store.labels(name))


def _link(target: Path, link: Path) -> None:
    # A short target is kept in the inode, a long one in a block of its own.
    os.symlink(os.path.relpath(target, link.parent), link)


def _write(run: Run, store: Store) -> None:
    # Not synced to the disk, unlike the list of a real run, because a year has many.
    plain = {"source": run.source, "segments": [asdict(entry) for entry in run.entries.values()]}
    (store.folder / "runs" / f"{Run.name_of(run.source)}.json").write_text(json.dumps(plain))


def _described(year: Year, robot: int, number: int, real: Store, model: Entry, out: Path) -> Path:
    """A folder with the arrays of a real shard that says it is of this run."""
    source = real.shard(model.shard or "").resolve()
    folder = out / f"{robot:03d}-{number:04d}-{model.file}"
    folder.mkdir()
    for array in source.glob("*.npy"):
        os.symlink(array, folder / array.name)
    meta: dict[str, Any] = json.loads((source / META_FILE).read_text())
    began = BEGIN + YEAR * number / year.runs
    meta["recorded"] |= {
        "scene": SCENE.format(home=robot, stairs=int(robot % 3 == 0)),
        "zero_unix_ns": int(began.timestamp()) * 1_000_000_000,
        "identity": {
            "boot": "",
            "robot": hashlib.sha256(str(robot).encode()).hexdigest(),
            "name": f"vacuum-{robot:03d}",
            "site": f"home-{robot:03d}",
            "run": hashlib.md5(folder.name.encode()).hexdigest(),
        },
    }
    # A number of stops that differs between runs.
    meta["events"] = {"goal_chosen": 3, "safety": (robot + number) % 5, "lost": int((robot * number) % 17 == 0)}
    text = json.dumps(meta, indent=1, sort_keys=True)
    (folder / META_FILE).write_text(text)
    sums = [line for line in (source / SUMS_FILE).read_text().splitlines() if not line.endswith(META_FILE)]
    sums.append(f"{hashlib.sha256(text.encode()).hexdigest()}  {META_FILE}")
    (folder / SUMS_FILE).write_text("\n".join(sums) + "\n")
    return folder
