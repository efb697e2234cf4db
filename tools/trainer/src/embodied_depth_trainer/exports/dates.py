"""Dates of recorded times. Recordings have the times of the robot's monotonic clock; ROS shows dates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from embodied_depth_trainer.exports.ticks import read_header


@dataclass(frozen=True)
class Dates:
    """How the times of a run become dates."""

    zero_unix_ns: int
    """Unix time at which the run's clock was zero."""
    is_recorded: bool
    """Whether the recording says so; otherwise the run begins when its first file was written."""

    @staticmethod
    def of(segments: Sequence[Path]) -> Dates:
        """A robot may begin with a wrong date and learn the right one from the network, so the last segment's date is
        that of all times."""
        headers = [(file, header) for file in segments if (header := read_header(file)) is not None]
        dated = [header["zero_unix_ns"] for _, header in headers if header.get("zero_unix_ns") is not None]
        if dated:
            return Dates(int(dated[-1]), True)
        if not headers:
            return Dates(0, False)
        file, header = headers[0]
        return Dates(max(0, file.stat().st_mtime_ns - int(header["first_time_ns"])), False)

    def unix_ns(self, time_ns: int) -> int:
        return self.zero_unix_ns + time_ns
