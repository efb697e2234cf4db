"""Trains depth networks on a robot's recordings, evaluates them and exports them for the robot."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from embodied_depth_trainer import __version__
from embodied_depth_trainer.commands import experiment
from embodied_depth_trainer.errors import TrainerError


@dataclass(frozen=True)
class Command:
    """A subcommand. Its module is imported when it is used, because many of them need PyTorch, which takes seconds."""

    module: str
    """In this package."""
    add: str
    """The module's function that adds the options."""
    run: str
    """The module's function that runs the command."""
    help: str

    def add_options(self, command: argparse.ArgumentParser) -> None:
        module: Any = importlib.import_module(f"embodied_depth_trainer.commands.{self.module}")
        add: Callable[[argparse.ArgumentParser], None] = getattr(module, self.add)
        add(command)
        command.set_defaults(run_command=getattr(module, self.run))


def _command(module: str, help_text: str, name: str | None = None, run: str | None = None) -> Command:
    name = name or module
    return Command(module, f"add_{name}", run or f"run_{name}", help_text)


COMMANDS = {
    "export-flow": _command("export", "export RAFT as an ONNX file for the robot's FlowNetwork", "flow"),
    "export-depth": _command(
        "export",
        "export a depth network with given or random weights as an ONNX file for the robot's DepthNetwork",
        "depth",
    ),
    "prepare": _command(
        "prepare", "make of recordings what trainings read: frames, coarse depth, poses and labels of each segment"
    ),
    "catalogue": _command(
        "catalogue", "answer questions about the segments of a store in SQL, freeze sets of them, and draw them"
    ),
    "erase": _command("erase", "erase a run from a store and from an object store, with a receipt"),
    "convert": _command("convert", "write recorded runs as LeRobot datasets or ROS 2 bags"),
    "train": _command("train", "train a depth network on recordings, without a depth sensor"),
    "loop": _command(
        "loop", "alternate exploration and training in one scene (algorithm 1 of the paper)", run="run_loop_command"
    ),
    "fleet": _command("fleet", "train one network per policy and architecture on recordings of many homes"),
    "jobs": _command("jobs", "print a job file: every network x policy x scene x seed", run="run_jobs_command"),
    "results": _command("results", "make the tables and figures of a study"),
    "adapt": _command(
        "adapt", "measure how much better depth gets in a simulated home by training on a drive through it"
    ),
    "evaluate": _command("evaluate", "measure a trained network beside simple baselines"),
    "make-default": _command(
        "make_default", "make the robot's default network: explore, label, train, calibrate, export"
    ),
    "calibrate": _command(
        "calibrate", "calibrate the confidence of an exported student on homes that it was not trained on"
    ),
    "calibrate-camera": _command(
        "calibrate_camera", "measure the camera's intrinsics with a printed board, or take over those of ROS or Kalibr"
    ),
    "watch": _command("watch", "train on recordings as pull-buffer brings them, and pass each network to a command"),
    "provenance": _command("provenance", "say what a model was trained on, from which weights and for how many steps"),
    "card": _command("card", "write the card of a network or a dataset for a model hub, from what the files say"),
    "hub": _command("hub", "upload a network or a dataset to a model hub, or download and check one"),
    "export": _command("export", "export a trained network as an ONNX file for the robot"),
}


def parser(chosen: str | None) -> argparse.ArgumentParser:
    """All commands, with the options of the chosen one."""
    top = argparse.ArgumentParser(prog="embodied-depth", description=__doc__)
    top.add_argument("--version", action="version", version=f"embodied-depth {__version__}")
    commands = top.add_subparsers(dest="command", required=True)
    for name, command in COMMANDS.items():
        added = commands.add_parser(name, help=command.help, description=command.help)
        if name == chosen:
            command.add_options(added)
    return top


def with_experiment(arguments: Sequence[str]) -> Sequence[str]:
    """Inserts the options of `--experiment FILE` right after the subcommand, so that typed options override them."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--experiment", type=Path)
    found, _ = finder.parse_known_args(arguments)
    return arguments if found.experiment is None else [arguments[0], *experiment.read(found.experiment), *arguments[1:]]


def main(arguments: Sequence[str] | None = None) -> int:
    try:
        typed = sys.argv[1:] if arguments is None else arguments
        options = parser(typed[0] if typed else None).parse_args(with_experiment(typed))
        options.run_command(options)
    except TrainerError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; run the same command again to continue from the last checkpoint", file=sys.stderr)
        return 130
    return 0
