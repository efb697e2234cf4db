"""Runs of which nothing was missing when they were last planned, so that the next plan need not read their lists.

A run is skipped if its segments and its list are those of then, and if the store still has its shards and labels. The
file may be removed: the next plan reads all lists and writes it again.
"""

from __future__ import annotations

import io
import os
import zipfile
from contextlib import suppress
from dataclasses import dataclass, fields
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer import __version__
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import process_name, write_atomically
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.manifest import Run
from embodied_depth_trainer.store.sources import RecordedRun
from embodied_depth_trainer.store.store import Names, Store, name_hash

COMPLETE_FILE = "complete.npz"
Hashes = NDArray[np.int64]


@dataclass(frozen=True)
class _Known:
    """Of each run: where it is recorded, the state of its files, and the shards and labels that were made of it."""

    sources: Hashes
    places: Hashes
    """Of the source and its first segment, because an object store may list a run in several parts."""
    states: Hashes
    counts: Hashes
    """Number of names of each run."""
    names: Hashes
    """Of all runs, one after the other."""

    @property
    def is_sound(self) -> bool:
        arrays = [getattr(self, name) for name in ARRAYS]
        if any(array.dtype != np.int64 or array.ndim != 1 for array in arrays):
            return False
        lengths = {len(array) for array in arrays[:-1]}
        return len(lengths) == 1 and bool((self.counts >= 0).all()) and int(self.counts.sum()) == len(self.names)


ARRAYS = [of.name for of in fields(_Known)]
NOTHING = _Known(*(np.empty(0, np.int64) for _ in ARRAYS))


@dataclass(frozen=True)
class _Added:
    source: int
    state: int
    names: Hashes


class CompleteRuns:
    """What is known of a store's runs while a plan is made."""

    def __init__(self, store: Store, robots: KnownRobots | None, in_store: tuple[Names, Names]) -> None:
        self.store = store
        # Another version may name labels by another rule, and other robots decide about other segments.
        self.rules = f"{__version__} {robots.digest if robots is not None else 'all'}"
        self.file = store.folder / COMPLETE_FILE
        self.before = self._read()
        self.still_there = dict(self._still_there(in_store))
        self.added: dict[int, _Added] = {}
        self.listed: set[int] = set()
        """The places of the runs that this plan has met."""

    def state(self, recorded: RecordedRun) -> int | None:
        """The state of a run's files; `None` if it has no list yet."""
        try:
            listed = self.store.run_file(recorded.source).stat()
        except FileNotFoundError:
            return None
        state = blake2b(f"{self.rules}\n{listed.st_size} {listed.st_mtime_ns}\n".encode(), digest_size=8)
        for segment in recorded.segments:
            state.update(f"{segment.name} {segment.state()}\n".encode())
        return int.from_bytes(state.digest(), "little", signed=True)

    def has(self, recorded: RecordedRun, state: int | None) -> bool:
        """Whether nothing was missing of the run in this state, and its shards and labels are still there."""
        place = _place(recorded)
        self.listed.add(place)
        return state is not None and self.still_there.get(place) == state

    def add(self, recorded: RecordedRun, state: int | None, run: Run) -> None:
        """Nothing is missing of the run, which was in this state before that was examined."""
        if state is not None:
            names = {name for entry in run.shards for name in (entry.shard, entry.labels) if name is not None}
            hashes = np.fromiter((name_hash(name) for name in names), np.int64, len(names))
            self.added[_place(recorded)] = _Added(name_hash(recorded.source), state, hashes)

    def write(self) -> None:
        """Keeps what was added, and of the runs of before those that are still complete."""
        if not self.added:
            return
        before = self.before
        kept = self._kept()
        ends = np.cumsum(before.counts)
        added = self.added.values()
        names = [before.names[ends[index] - before.counts[index] : ends[index]] for index in kept]
        names += [new.names for new in added]
        known = _Known(
            np.array([*before.sources[kept], *(new.source for new in added)], np.int64),
            np.array([*before.places[kept], *self.added], np.int64),
            np.array([*before.states[kept], *(new.state for new in added)], np.int64),
            np.array([len(hashes) for hashes in names], np.int64),
            np.concatenate(names),
        )
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **{name: getattr(known, name) for name in ARRAYS})
        own = self.file.with_name(f"{self.file.name}.{process_name()}")
        # Without the file the next plan takes longer. Of several processes, one wins.
        with suppress(OSError, TrainerError):
            write_atomically(buffer.getvalue(), own)
            os.replace(own, self.file)

    def _kept(self) -> list[int]:
        """The runs of before that are still complete. A run whose first segment was deleted since is another place of
        the same source."""
        sources = {new.source for new in self.added.values()}
        kept = []
        for index, (source, place) in enumerate(zip(self.before.sources, self.before.places, strict=True)):
            is_gone = int(source) in sources and int(place) not in self.listed
            if int(place) in self.still_there and int(place) not in self.added and not is_gone:
                kept.append(index)
        return kept

    def _read(self) -> _Known:
        try:
            with np.load(self.file, allow_pickle=False) as arrays:
                known = _Known(*(arrays[name] for name in ARRAYS))
        except (OSError, EOFError, ValueError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile):
            return NOTHING
        return known if known.is_sound else NOTHING

    def _still_there(self, in_store: tuple[Names, Names]) -> zip[tuple[int, int]]:
        """The runs whose shards and labels are all in the store: place and state."""
        known = self.before
        is_there = in_store[0].have(known.names) | in_store[1].have(known.names)
        # Sums before the names of each run and behind them.
        found = np.concatenate([[0], np.cumsum(is_there)])
        ends = np.cumsum(known.counts)
        chosen = found[ends] - found[ends - known.counts] == known.counts
        return zip(known.places[chosen].tolist(), known.states[chosen].tolist(), strict=True)


def _place(recorded: RecordedRun) -> int:
    # An object store may list a run in several parts.
    return name_hash(f"{recorded.source}/{recorded.segments[0].name}")
