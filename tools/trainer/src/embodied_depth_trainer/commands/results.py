"""`embodied-depth results`: the tables and figures of a study."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.studies.results import write_report
from embodied_depth_trainer.studies.study import CELLS_FILE, SETTINGS_FILE, collect, read_study, write_study


def add_results(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--runs", type=Path, help=f"first collect the loops below this directory into OUT/{CELLS_FILE}"
    )
    command.add_argument(
        "--out", type=Path, required=True, help=f"directory of {CELLS_FILE}, {SETTINGS_FILE}, tables and figures"
    )


def run_results(options: argparse.Namespace) -> None:
    if options.runs is not None:
        write_study(collect(options.runs), options.out)
    write_report(read_study(options.out), options.out)
