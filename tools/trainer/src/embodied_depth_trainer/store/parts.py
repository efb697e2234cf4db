"""Divides the segments of all runs among processes that fill one store at the same time and know nothing of each other,
such as the tasks of a SLURM array."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from embodied_depth_trainer.store.sources import RecordedRun, RecordedSegment


@dataclass(frozen=True)
class Part:
    """Every `count`th segment of each run."""

    number: int
    """From 1 to `count`."""
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def of(self, run: RecordedRun) -> Sequence[RecordedSegment]:
        """The segments of a run that belong to this part.

        A segment is in the part that its number says, not its place in a listing: tasks of an array may begin hours
        apart, and meanwhile the run gets new segments and loses old ones. The runs begin with different parts, because
        otherwise the first part would have all runs that have one segment.
        """
        first = int.from_bytes(hashlib.sha256(run.source.encode()).digest()[:8])
        return [segment for segment in run.segments if (first + _number(segment)) % self.count == self.number - 1]


def _number(segment: RecordedSegment) -> int:
    """N of `recording_N.mcap`."""
    return int(segment.name.removesuffix(".mcap").rpartition("_")[2])
