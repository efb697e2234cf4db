"""`embodied-depth loop`: one closed loop of exploration and training, or many from a job file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from embodied_depth_trainer.commands.arguments import POLICIES, add_network, add_study_options
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.studies.jobs import read_jobs, run_jobs
from embodied_depth_trainer.studies.loop import LoopSettings, run_loop
from embodied_depth_trainer.training.initial import chosen


def add_loop(command: argparse.ArgumentParser) -> None:
    add_one_loop(command)
    many = command.add_argument_group("many loops")
    many.add_argument(
        "--jobs", type=Path, metavar="FILE", help="run the loops of this file, the options above per line"
    )
    many.add_argument("--job", type=int, metavar="N", help="run only job N of the file, counted from 1")
    many.add_argument("--workers", type=int, default=1, help="number of loops that run at a time [1]")


def add_one_loop(command: argparse.ArgumentParser) -> None:
    defaults = LoopSettings("", "", "", 0)
    command.add_argument("--scene", help="builtin:apartment?seed=1 (also house, office), or a .glb, .gltf or .obj file")
    command.add_argument("--policy", choices=POLICIES, default="active")
    add_network(command)
    command.add_argument(
        "--scale", type=float, default=defaults.scale, help="scale of the paper's schedule of 30,000 frames [0.1]"
    )
    command.add_argument("--out", type=Path, help="directory; an interrupted loop in it continues")
    command.add_argument(
        "--labels", action="store_true", help="train on labels from the whole recording, as the default network does"
    )
    command.add_argument("--decay", action="store_true", help="reduce the learning rate to 0 during the last training")
    command.add_argument(
        "--views-dir", type=Path, help="directory of test views that loops in the same scene share [OUT/views]"
    )
    add_study_options(
        command,
        defaults.size,
        defaults.step_scale,
        defaults.batch,
        defaults.learning_rate,
        defaults.views,
        defaults.views_seed,
    )


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
        init=chosen(options.init),
        amp=options.amp,
    )
    device = pick_device(options.device)
    result = run_loop(settings, options.out, options.firmware_host, options.views_dir, options.threads, device)
    print(f"{result}; see curve.png and views.png beside it, and run/map.png", file=sys.stderr)
