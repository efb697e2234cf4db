"""What a training has read: one period for each dataset, in the order of its steps.

A training may be continued on another dataset, as `watch` does in every round. Its network then comes from all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from embodied_depth_trainer import __version__

TRAINER = f"embodied-depth-trainer {__version__}"

Period = dict[str, Any]
"""In the types of JSON: `from_step`, the number of steps before it; `trainer`, the program; and the summary of its
dataset (`DatasetVersion.summary`), unless the frames came from no shard."""


def begun(step: int, dataset: Mapping[str, Any] | None) -> Period:
    return {"from_step": step, "trainer": TRAINER, **(dataset or {})}


def continued(history: Sequence[Period], step: int, dataset: Mapping[str, Any] | None) -> list[Period]:
    """The periods of a training that goes on at this step."""
    # A checkpoint of an earlier version does not say what its steps have read.
    known = list(history) or [{"from_step": 0}]
    now = begun(step, dataset)
    # A dataset on which no step was made is not part of the training.
    used = [period for period in known if period["from_step"] < step]
    return used if used and {**used[-1], "from_step": step} == now else [*used, now]


def described(history: Sequence[Period], steps: int | None = None) -> list[str]:
    """A line for each period."""
    ends = [*(period["from_step"] for period in history[1:]), steps]
    return [_line(period, end) for period, end in zip(history, ends, strict=True)]


def _line(period: Period, end: int | None) -> str:
    steps = (
        f"steps {period['from_step'] + 1} to {end}" if end is not None else f"from step {period['from_step'] + 1} on"
    )
    by = f", by {period['trainer']}" if "trainer" in period else ""
    if "version" not in period:
        return f"{steps}: the file does not say on which recordings{by}"
    every = f", one of every {period['every']} frames" if period["every"] > 1 else ""
    size = f"{period['frames']} frames, {_count(period['shards'], 'shard')} of {_count(period['runs'], 'run')}"
    return f"{steps}: dataset {period['version']} ({size}{every}){by}"


def _count(number: int, name: str) -> str:
    return f"{number} {name}" if number == 1 else f"{number} {name}s"


def versions(history: Sequence[Period]) -> list[str]:
    """The names of the datasets, each once."""
    return list(dict.fromkeys(period["version"] for period in history if "version" in period))
