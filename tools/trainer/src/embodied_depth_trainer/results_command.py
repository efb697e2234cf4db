"""`embodied-depth results` and `embodied-depth jobs`: a study's report, and its job file."""

from __future__ import annotations

import argparse
import itertools
import re
import shlex
from pathlib import Path

from .depth_networks import DEPTH_NETWORKS
from .loop_command import POLICIES, parse_job
from .results import RAW_FILE, collect, read_raw, write_raw, write_report


def add_results(command: argparse.ArgumentParser) -> None:
    command.add_argument("--runs", type=Path, help=f"collect the loops below this folder into OUT/{RAW_FILE} first")
    command.add_argument("--out", type=Path, required=True, help=f"folder of {RAW_FILE}, tables and figures")


def run_results(options: argparse.Namespace) -> None:
    raw = options.out / RAW_FILE
    if options.runs is not None:
        write_raw(collect(options.runs), raw)
    write_report(read_raw(raw), options.out)


def add_jobs(command: argparse.ArgumentParser) -> None:
    command.add_argument("--scene", action="append", required=True, help="may be repeated, as the next three")
    command.add_argument("--policy", action="append", choices=POLICIES, required=True)
    command.add_argument("--network", action="append", choices=DEPTH_NETWORKS, required=True)
    command.add_argument("--seed", action="append", type=int, required=True)
    command.add_argument("--out", type=Path, required=True, help="each loop gets a folder in it")
    command.add_argument("rest", nargs="*", help="after --: arguments that all loops share")


def run_jobs_command(options: argparse.Namespace) -> None:
    """Prints a job file. Whole homes first: what is done when time is up can be compared."""
    for seed, scene, network, policy in itertools.product(options.seed, options.scene, options.network, options.policy):
        home = re.sub(r"\W+", "-", scene.removeprefix("builtin:"))
        out = options.out / f"{home}_{seed}_{network}_{policy}"
        job = ["--scene", scene, "--policy", policy, "--network", network, "--seed", str(seed), "--out", str(out)]
        job += ["--views-dir", str(options.out / "views" / home), *options.rest]
        # A mistake in the shared arguments shows here, not in every job.
        parse_job(job)
        print(shlex.join(job))
