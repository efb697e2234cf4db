"""`embodied-depth loop`: one loop, or many by a job file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .arguments import picture_size
from .depth_networks import DEPTH_NETWORKS
from .errors import TrainerError
from .fleet import FleetSettings
from .jobs import read_jobs, run_jobs
from .loop import LoopSettings, run_loop

POLICIES = ("random", "heuristic", "forward", "frontier", "inconsistency", "active")


def add_loop(command: argparse.ArgumentParser) -> None:
    add_one_loop(command)
    many = command.add_argument_group("many loops")
    many.add_argument("--jobs", type=Path, metavar="FILE", help="one loop a line: these very arguments")
    many.add_argument("--job", type=int, metavar="N", help="only line N of the file, counted from 1")
    many.add_argument("--workers", type=int, default=1, help="loops at a time [1]")


def add_one_loop(command: argparse.ArgumentParser) -> None:
    usual = LoopSettings("", "", "", 0)
    command.add_argument("--scene", help="builtin:apartment?seed=1 (also house, office), or a .glb, .gltf or .obj file")
    command.add_argument("--policy", choices=POLICIES, default="active")
    command.add_argument("--network", choices=DEPTH_NETWORKS, default="student")
    command.add_argument(
        "--scale", type=float, default=usual.scale, help="of the paper's schedule of 30,000 frames [0.1]"
    )
    command.add_argument("--out", type=Path, help="a loop in it goes on from where it is")
    command.add_argument(
        "--labels", action="store_true", help="train on labels from the whole recording, as the default network"
    )
    command.add_argument("--decay", action="store_true", help="let the learning rate go down in the last training")
    command.add_argument("--views-dir", type=Path, help="test views to share between loops of a scene [OUT/views]")
    add_shared(command, usual)


def add_shared(command: argparse.ArgumentParser, usual: LoopSettings | FleetSettings) -> None:
    """What a loop and a fleet take alike."""
    command.add_argument("--seed", type=int, default=1, help="of everything random [1]")
    command.add_argument("--size", type=picture_size, default=usual.size, help="rows x columns of pictures [96x320]")
    command.add_argument(
        "--step-scale", type=float, default=usual.step_scale, help="of steps of 3 cm and 2 degrees [1]"
    )
    command.add_argument("--gap", type=int, help="pairs this many frames apart, as the paper's 4 [by baseline]")
    command.add_argument("--batch", type=int, default=usual.batch)
    command.add_argument("--learning-rate", type=float, default=usual.learning_rate, help="of Adam [1e-4]")
    command.add_argument("--views", type=int, default=usual.views, help="test views of each scene [200]")
    command.add_argument("--views-seed", type=int, default=usual.views_seed)
    command.add_argument("--firmware-host", type=Path, metavar="FILE", help="the robot's program [on the PATH]")
    command.add_argument("--threads", type=int, default=1, help="of the CPU [1]")


def run_loop_command(options: argparse.Namespace) -> None:
    if options.jobs is None:
        run_one(options)
        return
    lines = read_jobs(options.jobs)
    if options.job is None:
        run_jobs(lines, options.workers)
    elif 1 <= options.job <= len(lines):
        run_one(parse_job(lines[options.job - 1]))
    else:
        raise TrainerError(f"{options.jobs} has jobs 1 to {len(lines)}; there is no job {options.job}")


def parse_job(line: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="embodied-depth loop", description="one line of a job file")
    add_one_loop(parser)
    return parser.parse_args(line)


def run_one(options: argparse.Namespace) -> None:
    if options.scene is None or options.out is None:
        raise TrainerError("a loop needs --scene SCENE and --out DIR")
    settings = LoopSettings(
        scene=options.scene,
        policy=options.policy,
        network=options.network,
        seed=options.seed,
        scale=options.scale,
        size=options.size,
        step_scale=options.step_scale,
        gap=options.gap,
        batch=options.batch,
        learning_rate=options.learning_rate,
        labels=options.labels,
        decay=options.decay,
        views=options.views,
        views_seed=options.views_seed,
    )
    result = run_loop(settings, options.out, options.firmware_host, options.views_dir, options.threads)
    print(f"{result}; look at curve.png and views.png beside it, and at run/map.png", file=sys.stderr)
