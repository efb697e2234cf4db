"""Measured numbers of `embodied-depth evaluate --json` as a table, with the baselines that need no learning."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.sharing.cards import table
from embodied_depth_trainer.studies.evaluation import CONFIDENT, FILLED, JOINED, REFINED, Metrics

BASELINES = {
    "constant": "baseline: each image's median of the truth",
    "coarse": "baseline: coarse depth, without a network",
    FILLED: "baseline: coarse depth whose holes have the depth of the nearest cell",
    "dense": "baseline: dense depth, without a network",
    "untrained": "baseline: this architecture with random weights",
}
HEAD = ("", "right, of all pixels", "with depth", "delta1 of these", "abs rel", "RMSE, m", "calibration error")
EXPLAINED = (
    "`right`: depth is within 25 % of the truth without scaling; a pixel without depth counts as wrong. The columns "
    "from delta1 on are of the pixels with depth, not scaled either. Calibration error: mean distance between the "
    "predicted probability that depth is right and how often it is."
)


def results_table(file: Path, title: str) -> str:
    """A table for each part of the results. Refuses results that are not of the network `title`."""
    parts = _read(file)
    for rows in parts.values():
        if title not in rows:
            raise TrainerError(
                f"{file} has numbers of {', '.join(rows)} and none of {title}; measure this network with "
                f"`embodied-depth evaluate --model FILE --json {file}`"
            )
    tables = [
        (f"### {part}\n\n" if len(parts) > 1 else "") + table(HEAD, [_row(*row, title) for row in rows.items()])
        for part, rows in parts.items()
    ]
    return "\n\n".join([*tables, EXPLAINED])


def _read(file: Path) -> dict[str, dict[str, Metrics]]:
    """The rows of each part: one part for recordings, several for test views."""
    try:
        plain: dict[str, Any] = json.loads(file.read_text())
        parts = {"all": plain} if any("right" in row for row in plain.values()) else plain
        return {part: {name: Metrics(**row) for name, row in rows.items()} for part, rows in parts.items()}
    except (OSError, ValueError, TypeError, AttributeError) as problem:
        raise TrainerError(
            f"{file} has no results ({problem}); give a file of `embodied-depth evaluate --json`"
        ) from None


def _row(name: str, found: Metrics, title: str) -> list[str]:
    numbers = (found.right, found.share, found.delta1_unscaled, found.abs_rel_unscaled, found.rmse_m_unscaled)
    error = found.calibration_error
    return [_named(name, title), *(f"{value:.3f}" for value in numbers), "" if error is None else f"{error:.3f}"]


def _named(name: str, title: str) -> str:
    """A row's name in words."""
    pixels = {
        title + CONFIDENT: "where it is sure enough for the map",
        title + REFINED: "where there is coarse depth",
        title + JOINED: "joined with dense depth, as the robot uses it",
    }
    if name in pixels:
        return f"this network, {pixels[name]}"
    return f"**this network** ({name})" if name == title else BASELINES.get(name, name)
