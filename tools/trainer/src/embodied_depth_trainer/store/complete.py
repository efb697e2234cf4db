"""Runs of which nothing was missing when they were last planned, so that the next plan need not read their lists.

A run is skipped if its segments and its list are those of then, and if the store still has its shards and labels. The
file may be removed: the next plan reads all lists and writes it again.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, field
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer import __version__
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.manifest import Run
from embodied_depth_trainer.store.sources import RecordedRun
from embodied_depth_trainer.store.store import Names, Store, name_hash

COMPLETE_FILE = "complete.npz"
Hashes = NDArray[np.int64]


@dataclass
class _Known:
    """Of each run: where it is recorded, the state of its files, and the shards and labels that were made of it."""

    places: Hashes = field(default_factory=lambda: np.empty(0, np.int64))
    states: Hashes = field(default_factory=lambda: np.empty(0, np.int64))
    counts: Hashes = field(default_factory=lambda: np.empty(0, np.int64))
    """Number of names of each run."""
    names: Hashes = field(default_factory=lambda: np.empty(0, np.int64))
    """Of all runs, one after the other."""


class CompleteRuns:
    """What is known of a store's runs while a plan is made."""

    def __init__(self, store: Store, robots: KnownRobots | None, in_store: tuple[Names, Names]) -> None:
        self.store = store
        # Another version may name labels by another rule, and other robots decide about other segments.
        self.rules = f"{__version__} {robots.digest if robots is not None else 'all'}"
        self.file = store.folder / COMPLETE_FILE
        self.before = self._read()
        self.still_there = dict(self._still_there(in_store))
        self.added: dict[int, tuple[int, Hashes]] = {}

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
        return state is not None and self.still_there.get(_place(recorded)) == state

    def add(self, recorded: RecordedRun, state: int | None, run: Run) -> None:
        """Nothing is missing of the run, which was in this state before that was examined."""
        if state is not None:
            names = {name for entry in run.shards for name in (entry.shard, entry.labels) if name is not None}
            hashes = np.fromiter((name_hash(name) for name in names), np.int64, len(names))
            self.added[_place(recorded)] = (state, hashes)

    def write(self) -> None:
        """Keeps what was added, and of the runs of before those that are still complete."""
        if not self.added:
            return
        ends = np.cumsum(self.before.counts)
        kept = [
            index
            for index, place in enumerate(self.before.places.tolist())
            if place in self.still_there and place not in self.added
        ]
        names = [self.before.names[ends[index] - self.before.counts[index] : ends[index]] for index in kept]
        names += [hashes for _, hashes in self.added.values()]
        arrays = {
            "places": np.array([*self.before.places[kept], *self.added], np.int64),
            "states": np.array([*self.before.states[kept], *(state for state, _ in self.added.values())], np.int64),
            "counts": np.array([len(hashes) for hashes in names], np.int64),
            "names": np.concatenate(names),
        }
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays)
        write_atomically(buffer.getvalue(), self.file)

    def _read(self) -> _Known:
        try:
            with np.load(self.file, allow_pickle=False) as arrays:
                known = _Known(*(arrays[name] for name in ("places", "states", "counts", "names")))
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
            return _Known()
        is_whole = len(known.places) == len(known.states) == len(known.counts)
        return known if is_whole and known.counts.sum() == len(known.names) else _Known()

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
