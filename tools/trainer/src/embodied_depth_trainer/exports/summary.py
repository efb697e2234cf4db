"""What an export did, in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from embodied_depth_trainer.exports.runs import Run, is_being_written


@dataclass(frozen=True)
class Summary:
    """The result of an export."""

    text: str
    """What was written."""
    cut: list[Path]
    """The segments that end early; their complete ticks are exported."""
    remarks: list[str] = field(default_factory=list)
    """What else the user should know."""


def left_out(run: Run, summary: Summary) -> list[str]:
    """What could not be exported, a phrase for each."""
    return [*run.unread, *(_why_cut(run, file) for file in summary.cut)]


def _why_cut(run: Run, file: Path) -> str:
    if file == run.segments[-1] and is_being_written(file):
        return f"the rest of {file.name}, which is still being written"
    return f"the end of {file.name}, which is cut"
