"""Makes stores of synthetic recordings."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import numpy as np

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.store.prepare import Report, Tools, prepare
from embodied_depth_trainer.store.recipe import Recipe, engine_of
from embodied_depth_trainer.store.store import Store

from .fake_robot import wheels
from .recordings import write_segment

TRAINER = Path(__file__).resolve().parents[1]


def robot_in(folder: Path) -> Path:
    """A program that follows the protocol of `firmware-host`; it lists its calls in `firmware-host.calls`."""
    program = folder / "firmware-host"
    python = shlex.quote(sys.executable)
    program.write_text(
        f"""#!/bin/sh
if [ "$1" = --version ]; then echo firmware-host 0.0.0; exit; fi
echo "$@" >> "$0.calls"
export PYTHONPATH={TRAINER}:{TRAINER / "src"}
if [ "$1" = perceive ]; then shift; exec {python} -m tests.fake_engine "$@"; fi
exec {python} -m tests.fake_robot "$@"
"""
    )
    program.chmod(0o755)
    return program


def record(
    run: Path,
    frames: Frames,
    segments: list[int],
    numbers: range | None = None,
    identity: dict[str, str] | None = None,
) -> None:
    """Writes a run, or the segments of it with these numbers; `segments` are their lengths in frames."""
    run.mkdir(parents=True, exist_ok=True)
    ends = np.cumsum([0, *segments]).tolist()
    for number in numbers if numbers is not None else range(len(segments)):
        part = frames.at(slice(ends[number], ends[number + 1]))
        write_segment(run / f"recording_{number:04d}.mcap", part, wheels(part), number, identity=identity)


def tools(robot: Path, workers: int = 1, labels: bool = True) -> Tools:
    return Tools(Recipe("robot", engine_of(robot), labels=labels), robot, workers=workers)


def store_of(runs: Path, out: Path, robot: Path, labels: bool = True) -> Store:
    """The store of all runs below a directory."""
    wanted = tools(robot, labels=labels)
    store = Store.create(out, wanted.recipe)
    prepare([runs], store, wanted)
    return store


def without_coarse(runs: Path, out: Path) -> Store:
    """The store of all runs, without coarse depth and labels, which needs no robot."""
    recipe = Recipe("none", labels=False)
    store = Store.create(out, recipe)
    prepare([runs], store, Tools(recipe))
    return store


def calls(robot: Path) -> int:
    """How often the robot's program was called to compute something."""
    file = robot.with_name(f"{robot.name}.calls")
    return len(file.read_text().splitlines()) if file.exists() else 0


__all__ = ["Report", "calls", "record", "robot_in", "store_of", "tools", "without_coarse"]
