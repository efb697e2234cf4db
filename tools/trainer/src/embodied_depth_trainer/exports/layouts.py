"""The formats of exports, each with the packages that it needs."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.folder import Exported, Origin, read_exported, write_folder
from embodied_depth_trainer.exports.runs import Run
from embodied_depth_trainer.exports.summary import Summary, left_out

Export = Callable[[Run, Path, Callable[[int], object] | None], Summary]

# The module of each format; its function `export` writes a run into a new folder.
LAYOUTS = {"lerobot": "lerobot.dataset", "ros2": "ros2.bag"}


def exporter(layout: str) -> Export:
    """Imported late, because each format needs packages of its own."""
    try:
        module: Any = importlib.import_module(f"embodied_depth_trainer.exports.{LAYOUTS[layout]}")
    except ModuleNotFoundError as problem:
        raise TrainerError(
            f"--as {layout} needs the package {problem.name}; run `pip install -e 'tools/trainer[exports]'` in the "
            "checkout"
        ) from None
    export: Export = module.export
    return export


def export_run(layout: str, run: Run, to: Path) -> list[str]:
    """Exports a run, prints what was written, and returns what could not be exported, a phrase for each."""
    write = exporter(layout)
    run.check_order()
    origin = Origin.of(layout, run)
    earlier = read_exported(to, origin)
    if earlier is not None and earlier.origin == origin:
        print(f"{to}: exported before, and the run has not changed")
        return earlier.left_out
    said: list[Summary] = []

    def fill(partial: Path) -> Exported:
        with tqdm(total=run.bytes, unit="B", unit_scale=True, desc=str(run.path), disable=None) as bar:
            said.append(write(run, partial, bar.update))
        return Exported(origin, left_out(run, said[0]))

    exported = write_folder(to, origin, fill)
    print(f"{to}: {said[0].text}")
    for remark in [*said[0].remarks, *_missing(run)]:
        print(remark)
    return exported.left_out


def _missing(run: Run) -> list[str]:
    """That is no failure: a robot deletes segments for space."""
    return [f"missing: {gap}; deleted (the robot does so for space), or not copied" for gap in run.missing]
