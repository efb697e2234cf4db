"""`embodied-depth jobs`: prints a job file for `embodied-depth loop --jobs`."""

from __future__ import annotations

import argparse
import itertools
import re
import shlex
from pathlib import Path

from embodied_depth_trainer.commands.arguments import POLICIES
from embodied_depth_trainer.commands.loop import parse_job
from embodied_depth_trainer.networks.registry import DEPTH_NETWORKS


def add_jobs(command: argparse.ArgumentParser) -> None:
    command.add_argument("--scene", action="append", required=True, help="may be repeated, as the next three options")
    command.add_argument("--policy", action="append", choices=POLICIES, required=True)
    command.add_argument("--network", action="append", choices=DEPTH_NETWORKS, required=True)
    command.add_argument("--seed", action="append", type=int, required=True)
    command.add_argument("--out", type=Path, required=True, help="each loop gets a directory in it")
    command.add_argument("rest", nargs="*", help="after --: arguments that all loops share")


def run_jobs_command(options: argparse.Namespace) -> None:
    """Prints the jobs home by home, so that a study that is cut short has complete homes to compare."""
    for seed, scene, network, policy in itertools.product(options.seed, options.scene, options.network, options.policy):
        home = re.sub(r"\W+", "-", scene.removeprefix("builtin:"))
        out = options.out / f"{home}_{seed}_{network}_{policy}"
        job = ["--scene", scene, "--policy", policy, "--network", network, "--seed", str(seed), "--out", str(out)]
        job += ["--views-dir", str(options.out / "views" / home), *options.rest]
        # Reports a mistake in the shared arguments now instead of in every job.
        parse_job(job)
        print(shlex.join(job))
