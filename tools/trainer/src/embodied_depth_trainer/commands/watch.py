"""`embodied-depth watch`: trains on recordings as they arrive.

`pull-buffer --follow` fills a directory. Whenever it holds enough new frames, their coarse depth and labels are
computed, the training continues, and the network is exported and passed to a command such as `push-model`. The robot
decides whether it accepts the network: a refusal is printed, and the next round follows.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from mcap.exceptions import McapError
from mcap.reader import make_reader

from embodied_depth_trainer.commands.arguments import add_amp, add_device, add_firmware_host, add_init
from embodied_depth_trainer.commands.make_default import SETTINGS
from embodied_depth_trainer.data.dataset import find_pairs, read_frames
from embodied_depth_trainer.data.labels import write_labels
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.data.recording import IMAGE, segments
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.depth import export_checkpoint
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.studies.robot import find_firmware_host, last_lines
from embodied_depth_trainer.training.initial import SHIPPED, SHIPPED_NAME, chosen
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
    """Directory of coarse depth, labels, the checkpoint, models and the state."""
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


def watch(settings: WatchSettings) -> list[Path]:
    """Trains until `rounds` are done; returns the networks of this call."""
    settings.work.mkdir(parents=True, exist_ok=True)
    networks = []
    done, used = _read_state(settings.work)
    while settings.rounds is None or done < settings.rounds:
        available = sum(frame_count(run) for run in runs(settings.pulled))
        # Frames that arrive during the round count as new for the next one.
        if available - used < settings.frames:
            time.sleep(POLL_INTERVAL_S)
            continue
        _log(f"round {done}: {available} frames, {available - used} of them new")
        networks.append(_round(settings, done))
        done += 1
        used = available
        write_atomically(json.dumps({"rounds": done, "frames": used}).encode(), settings.work / STATE_FILE)
        _hand_over(settings, networks[-1])
    return networks


def runs(pulled: Path) -> list[Path]:
    """Directories that hold segments, in the order of their names."""
    return sorted({file.parent for file in pulled.rglob("recording_*.mcap")})


def frame_count(run: Path) -> int:
    """The number of frames in a run by the segments' indices. A segment without an index was cut off and counts once
    the run's next segment exists."""
    count = 0
    for file in segments(run):
        with file.open("rb") as stream:
            try:
                summary = make_reader(stream).get_summary()
            except McapError:
                continue
        if summary is not None and summary.statistics is not None:
            images = [channel.id for channel in summary.channels.values() if channel.topic == IMAGE]
            count += sum(summary.statistics.channel_message_counts.get(channel, 0) for channel in images)
    return count


def _read_state(work: Path) -> tuple[int, int]:
    try:
        state = json.loads((work / STATE_FILE).read_text())
    except FileNotFoundError:
        return 0, 0
    return int(state["rounds"]), int(state["frames"])


def _round(settings: WatchSettings, number: int) -> Path:
    folders = [_prepare(settings, run) for run in runs(settings.pulled) if frame_count(run) > 0]
    labels = [folder / "labels.npz" for folder in folders]
    coarse = [folder / "coarse" for folder in folders]
    frames = read_frames([folder / "run" for folder in folders], coarse, [], None, labels, settings.every)
    pairs, validation = find_pairs(frames, None, PairRule())
    training = settings.work / "training"
    trainer = Trainer(frames, pairs, _training(settings), settings.device)
    steps = (number + 1) * settings.steps
    with Progress(trainer, validation, steps, training, settings.steps // VALIDATIONS) as progress:
        checkpoint = train(trainer, steps, training, on_step=progress)
    if progress.rows:
        draw(training)
    network = settings.work / "models" / f"model_{number:04d}.onnx"
    network.parent.mkdir(exist_ok=True)
    export_checkpoint(checkpoint, None, network)
    _log(f"round {number}: {len(frames)} frames, {steps} steps in total: {network}")
    return network


def _training(settings: WatchSettings) -> Settings:
    """The settings of the training: those of the default network if it begins with random weights."""
    init = _initial(settings)
    if init is None:
        return settings.training
    return replace(settings.training, init=init, learning_rate=GOING_ON, cycle=settings.steps)


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


def _prepare(settings: WatchSettings, run: Path) -> Path:
    """Links a run's present segments and computes their coarse depth and labels, again whenever the run has grown."""
    folder = settings.work / "runs" / "_".join(run.relative_to(settings.pulled).parts or ("run",))
    files = segments(run)
    present = [f"{file.name} {file.stat().st_size}" for file in files]
    known = folder / "segments.json"
    if known.exists() and json.loads(known.read_text()) == present:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    # Segments that arrive meanwhile belong to the next round.
    (folder / "run").mkdir(parents=True)
    for file in files:
        (folder / "run" / file.name).symlink_to(file.resolve())
    command = [str(settings.robot), "perceive", "--recording", str(folder / "run")]
    _call([*command, "--out", str(folder / "look"), "--dump", str(folder / "coarse")], folder / "perceive.log")
    write_labels(read_frames([folder / "run"], [folder / "coarse"], [], None), folder / "labels.npz")
    # Written last, so that an interrupted preparation is repeated.
    write_atomically(json.dumps(present).encode(), known)
    return folder


def _call(command: Sequence[str], log: Path) -> None:
    with log.open("wb") as stream:
        try:
            done = subprocess.run(command, stdout=stream, stderr=stream, check=False)
        except OSError as problem:
            raise TrainerError(f"cannot run {command[0]}: {problem}; give --firmware-host FILE") from problem
    if done.returncode != 0:
        raise TrainerError(f"`{shlex.join(command)}` failed; {log} ends with\n{last_lines(log)}")


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
        )
    )
