"""`embodied-depth convert`: recorded runs in the formats of LeRobot and ROS 2."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.layouts import LAYOUTS, export_run
from embodied_depth_trainer.exports.runs import Run, is_run, runs


def add_convert(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "run", type=Path, metavar="RUN", help="the --out directory of a run, one segment, or a directory of runs"
    )
    command.add_argument(
        "--as",
        dest="layout",
        choices=tuple(LAYOUTS),
        required=True,
        help="lerobot: a LeRobot dataset, format 3.0, with images, localized poses, measured velocities and sent "
        "commands; ros2: a ROS 2 bag with images, calibration, scans, odometry, transforms, maps and decisions",
    )
    command.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="directory to create; of a directory of runs, DIR/NAME for each run. An earlier export is written again "
        "only if its run has grown, and nothing else is replaced",
    )


def run_convert(options: argparse.Namespace) -> None:
    found = runs(options.run)
    places = {run.path: options.out if is_run(options.run) else options.out / run.path.name for run in found}
    problems = [problem for run in found if (problem := _convert(options.layout, run, places[run.path])) is not None]
    if problems:
        raise TrainerError("; ".join(problems))


def _convert(layout: str, run: Run, to: Path) -> str | None:
    """Returns why the export of a run is not complete. The other runs are exported nevertheless."""
    try:
        left_out = export_run(layout, run, to)
    except TrainerError as problem:
        return str(problem)
    return f"left out of {to}: {', '.join(left_out)}" if left_out else None
