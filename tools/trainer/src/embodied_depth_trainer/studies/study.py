"""One study: closed loops that share their settings and differ only in the factors.

A study is stored as two files. `factorial.csv` has one row per loop and point of its curve, with those metrics that the
tables and figures are made from; `factorial_settings.json` has what all loops share.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.studies.loop import RESULT_FILE

CELLS_FILE = "factorial.csv"
SETTINGS_FILE = "factorial_settings.json"
# Settings in which the loops of one study may differ.
FACTORS = ("scene", "policy", "network", "seed", "gap")
# The metrics that are kept of every point: of the views in PARTS, for the network and the baselines.
PARTS = ("all", "drive", "turn")
METRICS = ("delta1", "delta1_unscaled")
NETWORK = "network"
BASELINES = ("constant", "coarse")
METRIC_COLUMNS = tuple(itertools.product(PARTS, (NETWORK, *BASELINES), METRICS))
COLUMNS = (*FACTORS, "coverage", "frames", "steps", *(" ".join(key) for key in METRIC_COLUMNS))
POLICY_ORDER = ("random", "heuristic", "forward", "inconsistency", "frontier", "active")

Key = tuple[str, str, str]
"""Views, what is evaluated (`network` or a baseline), and metric."""


@dataclass(frozen=True)
class Point:
    """The metrics of a loop's network at one point of its training."""

    frames: int
    steps: int
    metrics: dict[Key, float]
    """Without entries where there is nothing to measure: coarse depth after a rotation on the spot."""


@dataclass(frozen=True)
class Run:
    """One loop."""

    scene: str
    policy: str
    network: str
    seed: int
    gap: int | None
    """Distance of the pairs in frames; `None`: pairs by baseline."""
    coverage: float
    """Share of the reachable floor that was mapped."""
    curve: list[Point]
    """From the untrained network to the last checkpoint."""

    @property
    def by_baseline(self) -> bool:
        """Whether its pairs were chosen by baseline instead of by a fixed gap."""
        return self.gap is None

    def value(self, part: str = "all", metric: str = "delta1", of: str = NETWORK, point: int = -1) -> float:
        return self.curve[point].metrics[part, of, metric]

    def has(self, part: str, of: str) -> bool:
        return (part, of, METRICS[0]) in self.curve[-1].metrics


@dataclass(frozen=True)
class Study:
    """Loops that differ only in the factors."""

    settings: dict[str, Any]
    """What they share."""
    runs: list[Run]

    def networks(self) -> list[str]:
        return sorted({run.network for run in self.runs})

    def policies(self) -> list[str]:
        return sorted({run.policy for run in self.runs}, key=POLICY_ORDER.index)

    def main_runs(self) -> list[Run]:
        """The runs of the factorial; those with pairs at a fixed gap belong to a comparison of their own."""
        return [run for run in self.runs if run.gap is None]


def collect(folder: Path) -> Study:
    """Reads all finished loops below `folder`."""
    files = sorted(folder.rglob(RESULT_FILE))
    if not files:
        raise TrainerError(f"{folder} holds no {RESULT_FILE}; run loops with --out below it")
    shared: dict[str, Any] | None = None
    runs = []
    for file in files:
        result = json.loads(file.read_text())
        settings = {**result["settings"], "schedule": result["schedule"]}
        factors = {key: settings.pop(key) for key in FACTORS}
        if shared not in (None, settings):
            raise TrainerError(f"{file} was made with {settings}, others with {shared}; put each study into its folder")
        shared = settings
        curve = [_point(point, factors["network"]) for point in result["curve"]]
        runs.append(Run(**factors, coverage=float(result["exploration"]["coverage"]), curve=curve))
    return Study(shared or {}, runs)


def _point(point: dict[str, Any], network: str) -> Point:
    """Reduces a point of `result.json` to the metrics that are kept."""
    metrics: dict[Key, float] = {}
    for part, of, metric in METRIC_COLUMNS:
        row = point["metrics"].get(part, {}).get(network if of == NETWORK else of)
        if row is not None:
            metrics[part, of, metric] = float(row[metric])
    return Point(int(point["frames"]), int(point["steps"]), metrics)


def write_study(study: Study, folder: Path) -> None:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for run in study.runs:
        for point in run.curve:
            factors = [getattr(run, name) for name in FACTORS]
            # `repr`, which `csv` applies to floats, restores every bit.
            metrics = [point.metrics.get(key) for key in METRIC_COLUMNS]
            table.writerow([*factors, run.coverage, point.frames, point.steps, *metrics])
    write_atomically(text.getvalue().encode(), folder / CELLS_FILE)
    write_atomically((json.dumps(study.settings) + "\n").encode(), folder / SETTINGS_FILE)


def read_study(folder: Path) -> Study:
    file = folder / CELLS_FILE
    try:
        settings = json.loads((folder / SETTINGS_FILE).read_text())
        rows = list(csv.reader(io.StringIO(file.read_text())))
    except FileNotFoundError as problem:
        raise TrainerError(f"{problem.filename} does not exist; collect the study with --runs DIR") from None
    except json.JSONDecodeError as problem:
        raise TrainerError(f"{folder / SETTINGS_FILE} is not valid JSON: {problem}") from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise TrainerError(f"{file} does not have the columns of a study; collect it again with --runs DIR")
    return Study(settings, list(_runs(file, rows[1:])))


def _runs(file: Path, rows: list[list[str]]) -> Iterator[Run]:
    """Joins consecutive rows of the same loop."""
    # Number of columns before frames, steps and metrics.
    head = len(FACTORS) + 1
    for number, row in enumerate(rows, 2):
        if len(row) != len(COLUMNS):
            raise TrainerError(f"{file}, line {number}: {len(row)} values instead of {len(COLUMNS)}")
    for (scene, policy, network, seed, gap, coverage), group in itertools.groupby(rows, lambda row: row[:head]):
        try:
            curve = [_parse_point(row[head:]) for row in group]
            if any(later.frames <= earlier.frames for earlier, later in itertools.pairwise(curve)):
                raise ValueError("frames do not increase from row to row")
            run = Run(scene, policy, network, int(seed), int(gap) if gap else None, float(coverage), curve)
        except ValueError as problem:
            raise TrainerError(f"{file}: the rows of {scene}, {policy}, {network} are damaged: {problem}") from None
        yield run


def _parse_point(cells: list[str]) -> Point:
    frames, steps, *values = cells
    metrics = {key: float(value) for key, value in zip(METRIC_COLUMNS, values, strict=True) if value}
    if not all(math.isfinite(value) for value in metrics.values()):
        raise ValueError("a metric is not finite")
    return Point(int(frames), int(steps), metrics)
