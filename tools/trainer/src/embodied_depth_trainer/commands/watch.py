"""`embodied-depth watch`: trains on recordings as they arrive.

`pull-buffer --follow` fills a directory. Each segment that arrives is prepared once (`store/`). Whenever there are
enough new frames, the training continues, and the network is exported and passed to a command such as `push-model`. The
robot decides whether it accepts the network: a refusal is printed, and the next round follows.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from embodied_depth_trainer.commands.arguments import (
    add_amp,
    add_device,
    add_firmware_host,
    add_init,
    add_robots,
    known_robots,
)
from embodied_depth_trainer.commands.make_default import SETTINGS
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.depth import export_checkpoint
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.store.dataset import open_dataset, record_version
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.prepare import Tools, prepare
from embodied_depth_trainer.store.recipe import RESTART_EVERY, Recipe, engine_of
from embodied_depth_trainer.store.store import Store, is_store, restarts_of
from embodied_depth_trainer.studies.robot import find_firmware_host
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.initial import SHIPPED, SHIPPED_NAME, chosen, given_depth
from embodied_depth_trainer.training.progress import VALIDATIONS, Progress, draw
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import CHECKPOINT_FILE, Trainer, train

STATE_FILE = "watch.json"
POLL_INTERVAL_S = 2.0
# The default network's settings without decay, because the training has no end.
ENDLESS = replace(SETTINGS, decay=None)
# The learning rate for going on from a network that has learnt already. It falls to 0 in every round: at a constant
# rate of 3e-4, the validation loss was .107 after 480 steps and .120 after 600. Falling from 3e-4 it was .110 after
# 600, from 1e-3 .106.
GOING_ON = 1e-3


@dataclass(frozen=True)
class WatchSettings:
    """The settings of a watch."""

    pulled: Path
    """Directory that holds runs, at any depth."""
    work: Path
    """Directory of the store, the checkpoint, models and the state."""
    robot: Path
    """Path of firmware-host."""
    frames: int = 600
    """Number of new frames that start a round."""
    steps: int = 600
    """Training steps of a round."""
    every: int = 2
    """Only every Nth frame is trained on, because neighbouring frames add little."""
    then: str | None = None
    """Command that is run with each network; `{}` is replaced by its file."""
    rounds: int | None = None
    """Number of rounds; `None`: runs until it is interrupted."""
    training: Settings = ENDLESS
    init: str = SHIPPED_NAME
    """Weights that the first round goes on from, as `--init` names them."""
    device: str = "cpu"
    known_robots: KnownRobots | None = None
    """The robots whose segments are accepted; `None`: signatures are not checked."""


class Watch:
    """A directory that is watched, and its store."""

    def __init__(self, settings: WatchSettings) -> None:
        self.settings = settings
        folder = settings.work / "store"
        # A watch that an earlier version began goes on with the memory in all of its dense depth.
        restart_every = restarts_of(folder) if is_store(folder) else RESTART_EVERY
        recipe = Recipe("robot", engine_of(settings.robot), restart_every=restart_every)
        self.tools = Tools(recipe, settings.robot, known_robots=settings.known_robots)
        self.store = Store.create(folder, self.tools.recipe)
        # A shard's digests are compared once in the life of a watch.
        self.checked: set[str] = set()

    def look(self) -> int:
        """Prepares the segments that are new; returns the number of frames in all."""
        if self.settings.pulled.is_dir():
            report = prepare([self.settings.pulled], self.store, self.tools, growing=True)
            for file, why in report.damaged.items():
                _log(f"{file}: {why}")
            for file, why in report.refused.items():
                _log(f"{file}: refused: {why}")
            for line in report.breaks:
                _log(f"warning: {line}")
        return self.store.frames


def watch(settings: WatchSettings) -> list[Path]:
    """Trains until `rounds` are done; returns the networks of this call."""
    watched = Watch(settings)
    networks = []
    done, used = _read_state(settings.work)
    while settings.rounds is None or done < settings.rounds:
        available = watched.look()
        # Segments that are refused now may have been trained on before.
        used = min(used, available)
        # Frames that arrive during the round count as new for the next one.
        if available - used < settings.frames:
            time.sleep(POLL_INTERVAL_S)
            continue
        _log(f"round {done}: {available} frames, {available - used} of them new")
        networks.append(_round(watched, done))
        done += 1
        used = available
        write_atomically(json.dumps({"rounds": done, "frames": used}).encode(), settings.work / STATE_FILE)
        _hand_over(settings, networks[-1])
    return networks


def _read_state(work: Path) -> tuple[int, int]:
    try:
        state = json.loads((work / STATE_FILE).read_text())
    except FileNotFoundError:
        return 0, 0
    return int(state["rounds"]), int(state["frames"])


def _round(watched: Watch, number: int) -> Path:
    settings = watched.settings
    dataset = open_dataset([watched.store], every=settings.every, checked=watched.checked)
    chosen = _training(settings)
    pairs, validation = find_pairs(dataset, None, PairRule(), chosen.needs_sources)
    training = settings.work / "training"
    trainer = Trainer(dataset.frames, pairs, chosen, settings.device, dataset=dataset.summary)
    record_version(dataset, training)
    steps = (number + 1) * settings.steps
    with Progress(trainer, validation, steps, training, settings.steps // VALIDATIONS) as progress:
        checkpoint = train(trainer, steps, training, on_step=progress)
    if progress.rows:
        draw(training)
    network = settings.work / "models" / f"model_{number:04d}.onnx"
    network.parent.mkdir(exist_ok=True)
    export_checkpoint(checkpoint, None, network)
    _log(f"round {number}: {len(dataset.frames)} frames, {steps} steps in total: {network}")
    return network


def _training(settings: WatchSettings) -> Settings:
    """The settings of the training: those of the default network if it begins with random weights."""
    init = _initial(settings)
    training = _as_begun(settings)
    if init is None:
        return training
    given = given_depth(init)
    return replace(training, init=init, given_depth=given, learning_rate=GOING_ON, cycle=settings.steps)


def _as_begun(settings: WatchSettings) -> Settings:
    """The settings of this version, with those of the losses and the augmentation that the watch began with."""
    file = settings.work / "training" / CHECKPOINT_FILE
    if not file.exists():
        return settings.training
    begun = checkpoints.load(file).settings
    return replace(settings.training, coarse_weight=begun["coarse_weight"], color_change=begun.get("color_change"))


def _initial(settings: WatchSettings) -> str | None:
    """The file with the weights of the first round. The default network is copied to `work`, so that a newer one does
    not end a watch; a watch that began with random weights stays with them."""
    folder = settings.work / "init"
    if settings.init != SHIPPED_NAME:
        return chosen(settings.init)
    kept = sorted(folder.glob("*.onnx"))
    if not kept and not (settings.work / "training" / CHECKPOINT_FILE).exists():
        write_atomically(SHIPPED.read_bytes(), folder / SHIPPED.name)
        kept = [folder / SHIPPED.name]
    return str(kept[0]) if kept else None


def _hand_over(settings: WatchSettings, network: Path) -> None:
    if settings.then is None:
        return
    command = [part.replace("{}", str(network)) for part in shlex.split(settings.then)]
    try:
        code = subprocess.run(command, check=False).returncode
    except OSError as problem:
        raise TrainerError(f"cannot run `{shlex.join(command)}`: {problem}; see --then") from problem
    _log(f"{network.name}: {Path(command[0]).name} ended with {code}")


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def add_watch(command: argparse.ArgumentParser) -> None:
    command.add_argument("--pulled", type=Path, required=True, help="directory that pull-buffer fills")
    command.add_argument(
        "--work", type=Path, required=True, help="directory of results and state; an interrupted watch in it continues"
    )
    add_robots(command)
    add_firmware_host(command)
    defaults = WatchSettings(Path(), Path(), Path())
    command.add_argument(
        "--frames",
        type=int,
        default=defaults.frames,
        metavar="FRAMES",
        help=f"new frames that start a round [{defaults.frames}]",
    )
    command.add_argument(
        "--steps", type=int, default=defaults.steps, help=f"training steps per round [{defaults.steps}]"
    )
    add_init(command, SHIPPED_NAME)
    add_device(command)
    add_amp(command)
    command.add_argument("--rounds", type=int, help="number of rounds to run [no limit]")
    command.add_argument(
        "--then", metavar="COMMAND", help="command to run with each network, as 'push-model {} robot.local'"
    )
    command.add_argument("--threads", type=int, default=1, help="CPU threads [1]")


def run_watch(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    watch(
        WatchSettings(
            pulled=options.pulled,
            work=options.work,
            robot=find_firmware_host(options.firmware_host),
            frames=options.frames,
            steps=options.steps,
            then=options.then,
            rounds=options.rounds,
            training=replace(ENDLESS, amp=options.amp),
            init=options.init or SHIPPED_NAME,
            device=pick_device(options.device),
            known_robots=known_robots(options),
        )
    )
