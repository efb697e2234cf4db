"""What is to be done of many runs, and the lists of the runs that are worked on.

A year of a fleet has more segments than memory should hold: a plan is kept in a file, and of the lists only those are
in memory whose jobs are being done.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import SpooledTemporaryFile
from types import TracebackType
from typing import Generic, Self, TypeVar

from embodied_depth_trainer.store.manifest import Entry, Run
from embodied_depth_trainer.store.store import Store

Item = TypeVar("Item")
# Bytes of a plan that stay in memory.
IN_MEMORY = 8 << 20
# A list is written again when this part of it is new. So the work for a run grows with its segments and not with their
# square; a killed process loses one sixteenth of a list, whose shards it finds again.
UNWRITTEN = 1 / 16


class Plan(Generic[Item]):
    """Runs by their sources, and the items of each that are to be worked on."""

    def __init__(self, folder: Path) -> None:
        """`folder` is where a plan is kept that is not small; its file has no name and ends with the process."""
        self.file = SpooledTemporaryFile(IN_MEMORY, dir=str(folder))  # noqa: SIM115
        self.runs = 0
        self.total = 0
        """Number of items."""

    def add(self, source: str, items: Sequence[Item]) -> None:
        if not items:
            return
        pickle.dump((source, items), self.file)
        self.runs += 1
        self.total += len(items)

    def __iter__(self) -> Iterator[tuple[str, Sequence[Item]]]:
        self.file.seek(0)
        for _ in range(self.runs):
            yield pickle.load(self.file)


@dataclass
class _OpenRun:
    run: Run
    waiting: int = 0
    """Number of its jobs that are not done."""
    unwritten: int = 0
    new: set[str] = field(default_factory=set)


class OpenRuns:
    """The lists of the runs whose jobs are being done, while the context lasts: one is read with the first job of its
    run, and written and forgotten with the last."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.open: dict[str, _OpenRun] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        for opened in self.open.values():
            self._write(opened)

    def begin(self, source: str, jobs: int) -> None:
        """More jobs of a run will be done."""
        if jobs:
            self.open.setdefault(source, _OpenRun(self.store.run_of(source))).waiting += jobs

    def entry(self, source: str, file: str) -> Entry:
        return self.open[source].run.entries[file]

    def done(self, source: str, entry: Entry | None) -> tuple[Run, set[str]] | None:
        """Lists what a job has made, if anything. After the last job of a run: its list, and the files that are new."""
        opened = self.open[source]
        opened.waiting -= 1
        if entry is not None:
            opened.run.entries[entry.file] = entry
            opened.new.add(entry.file)
            opened.unwritten += 1
        is_last = opened.waiting == 0
        if is_last or opened.unwritten >= UNWRITTEN * len(opened.run.entries):
            self._write(opened)
        if not is_last:
            return None
        del self.open[source]
        return opened.run, opened.new

    def _write(self, opened: _OpenRun) -> None:
        if opened.unwritten:
            self.store.keep(opened.run)
            opened.unwritten = 0
