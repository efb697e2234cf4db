"""`embodied-depth watch`: whatever a robot's recordings bring, trained on as it comes.

`pull-buffer --follow` fills a folder; whenever enough new pictures are there, their coarse depth and labels are
computed, the training goes on where it was, and the network is exported and handed to a command, as `push-model`. What
the robot thinks of the network is its own affair: a refusal is printed, and the next round goes on.
"""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from tqdm import tqdm

from .checkpoint import write_atomically
from .commands import find_pairs, read_frames
from .default_network import SETTINGS
from .errors import TrainerError
from .export_depth import export_checkpoint
from .labels import write_labels
from .pairs import PairRule
from .recording import IMAGE, segments
from .robot import last_lines
from .training import Settings, Trainer, train

STATE_FILE = "watch.json"
LOOK_EVERY_S = 2.0
# The default network's recipe, without an end.
GOING_ON = replace(SETTINGS, decay=None)


@dataclass(frozen=True)
class WatchSettings:
    """All that shapes it."""

    pulled: Path
    """Holds runs, at any depth."""
    work: Path
    """Coarse depth, labels, checkpoint, models and what was done already."""
    robot: Path
    """The firmware-host."""
    pictures: int = 600
    """So many new ones begin a round."""
    steps: int = 600
    """Of a round."""
    every: int = 2
    """Every Nth picture is trained on: neighbours say the same."""
    then: str | None = None
    """Run with each network; `{}` stands for its file."""
    rounds: int | None = None
    """Ends after so many; `None`: goes on until it is told to stop."""
    training: Settings = GOING_ON


def watch(settings: WatchSettings) -> list[Path]:
    """Trains until `rounds` are done; the networks of this call."""
    settings.work.mkdir(parents=True, exist_ok=True)
    networks = []
    done, used = _state(settings.work)
    while settings.rounds is None or done < settings.rounds:
        there = sum(pictures_of(run) for run in runs(settings.pulled))
        # What comes during the round counts as new for the next.
        if there - used < settings.pictures:
            time.sleep(LOOK_EVERY_S)
            continue
        _tell(f"round {done}: {there} pictures, {there - used} of them new")
        networks.append(_round(settings, done))
        done, used = done + 1, there
        write_atomically(json.dumps({"rounds": done, "pictures": used}).encode(), settings.work / STATE_FILE)
        _hand_over(settings, networks[-1])
    return networks


def runs(pulled: Path) -> list[Path]:
    """Folders that hold segments, in the order of their names."""
    return sorted({file.parent for file in pulled.rglob("recording_*.mcap")})


def pictures_of(run: Path) -> int:
    """By the segments' own indices. One without an index was cut, and counts when the run's next segment is there."""
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


def _state(work: Path) -> tuple[int, int]:
    try:
        state = json.loads((work / STATE_FILE).read_text())
    except FileNotFoundError:
        return 0, 0
    return int(state["rounds"]), int(state["pictures"])


def _round(settings: WatchSettings, number: int) -> Path:
    folders = [_prepare(settings, run) for run in runs(settings.pulled) if pictures_of(run) > 0]
    labels = [folder / "labels.npz" for folder in folders]
    coarse = [folder / "coarse" for folder in folders]
    frames = read_frames([folder / "run" for folder in folders], coarse, [], None, labels, settings.every)
    trainer = Trainer(frames, find_pairs(frames, None, PairRule()), settings.training)
    steps = (number + 1) * settings.steps
    with tqdm(total=steps, unit="step", disable=None) as bar:

        def told(step: int, loss: float) -> None:
            bar.n = step
            bar.set_postfix(loss=f"{loss:.4f}", refresh=False)
            bar.update(0)

        checkpoint = train(trainer, steps, settings.work / "training", told=told)
    network = settings.work / "models" / f"model_{number:04d}.onnx"
    network.parent.mkdir(exist_ok=True)
    export_checkpoint(checkpoint, None, network)
    _tell(f"round {number}: {len(frames)} pictures, {steps} steps in all: {network}")
    return network


def _prepare(settings: WatchSettings, run: Path) -> Path:
    """A run as it is now, with coarse depth and labels; again when it has grown."""
    folder = settings.work / "runs" / "_".join(run.relative_to(settings.pulled).parts or ("run",))
    files = segments(run)
    there = [f"{file.name} {file.stat().st_size}" for file in files]
    known = folder / "segments.json"
    if known.exists() and json.loads(known.read_text()) == there:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    # Segments that come meanwhile are for the next round.
    (folder / "run").mkdir(parents=True)
    for file in files:
        (folder / "run" / file.name).symlink_to(file.resolve())
    command = [str(settings.robot), "perceive", "--recording", str(folder / "run")]
    _call([*command, "--out", str(folder / "look"), "--dump", str(folder / "coarse")], folder / "perceive.log")
    write_labels(read_frames([folder / "run"], [folder / "coarse"], [], None), folder / "labels.npz")
    # Last: what was interrupted is done again.
    write_atomically(json.dumps(there).encode(), known)
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
    _tell(f"{network.name}: {Path(command[0]).name} ended with {code}")


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
