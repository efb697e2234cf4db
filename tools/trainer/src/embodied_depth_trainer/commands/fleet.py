"""`embodied-depth fleet`: one network for each policy from the recordings of many homes."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.commands.arguments import POLICIES, add_study_options
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.registry import DEPTH_NETWORKS
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.studies.fleet import Fleet, FleetSettings
from embodied_depth_trainer.training.initial import chosen


def add_fleet(command: argparse.ArgumentParser) -> None:
    defaults = FleetSettings(frames=0, steps=0)
    command.add_argument("--scene", action="append", required=True, help="a home; may be repeated, as the next two")
    command.add_argument("--policy", action="append", choices=POLICIES, required=True)
    command.add_argument("--network", action="append", choices=DEPTH_NETWORKS, required=True)
    command.add_argument("--frames", type=int, required=True, help="frames for which each robot explores")
    command.add_argument("--steps", type=int, required=True, help="steps of each training")
    command.add_argument("--out", type=Path, required=True, help="directory; an interrupted study in it continues")
    command.add_argument("--encoder", metavar="FILE", help="as for `train` [random]")
    add_study_options(
        command,
        defaults.size,
        defaults.step_scale,
        defaults.batch,
        defaults.learning_rate,
        defaults.views,
        defaults.views_seed,
    )


def run_fleet(options: argparse.Namespace) -> None:
    settings = FleetSettings(
        frames=options.frames,
        steps=options.steps,
        seed=options.seed,
        size=options.size,
        step_scale=options.step_scale,
        gap=options.gap,
        batch=options.batch,
        learning_rate=options.learning_rate,
        encoder=options.encoder,
        views=options.views,
        views_seed=options.views_seed,
        init=chosen(options.init),
        amp=options.amp,
    )
    if settings.frames < 1 or settings.steps < 1:
        raise TrainerError(
            f"{settings.frames} frames and {settings.steps} steps train nothing; give at least 1 of each"
        )
    if settings.init is not None and len(options.network) > 1:
        raise TrainerError(f"--init {options.init} fits one architecture; give one --network")
    fleet = Fleet(settings, options.scene, options.out, options.firmware_host, pick_device(options.device))
    fleet.study(options.policy, options.network, options.threads)
    print(f"{options.out}/results; tables: embodied-depth results --runs {options.out}/results --out DIR")
