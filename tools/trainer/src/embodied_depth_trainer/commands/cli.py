"""Trains depth networks on a robot's recordings, evaluates them and exports them for the robot."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from embodied_depth_trainer.commands import (
    calibrate,
    calibrate_camera,
    catalogue,
    evaluate,
    experiment,
    export,
    fleet,
    jobs,
    loop,
    make_default,
    prepare,
    provenance,
    results,
    train,
    watch,
)
from embodied_depth_trainer.errors import TrainerError

# Name, module function that adds the options, function that runs the command, and a line of help.
COMMANDS = (
    ("export-flow", export.add_flow, export.run_flow, "export RAFT as an ONNX file for the robot's FlowNetwork"),
    (
        "export-depth",
        export.add_depth,
        export.run_depth,
        "export a depth network with given or random weights as an ONNX file for the robot's DepthNetwork",
    ),
    (
        "prepare",
        prepare.add_prepare,
        prepare.run_prepare,
        "make of recordings what trainings read: frames, coarse depth, poses and labels of each segment",
    ),
    (
        "catalogue",
        catalogue.add_catalogue,
        catalogue.run_catalogue,
        "answer questions about the segments of a store in SQL, freeze sets of them, and draw them",
    ),
    ("train", train.add_train, train.run_train, "train a depth network on recordings, without a depth sensor"),
    (
        "loop",
        loop.add_loop,
        loop.run_loop_command,
        "alternate exploration and training in one scene (algorithm 1 of the paper)",
    ),
    (
        "fleet",
        fleet.add_fleet,
        fleet.run_fleet,
        "train one network per policy and architecture on recordings of many homes",
    ),
    ("jobs", jobs.add_jobs, jobs.run_jobs_command, "print a job file: every network x policy x scene x seed"),
    ("results", results.add_results, results.run_results, "make the tables and figures of a study"),
    ("evaluate", evaluate.add_evaluate, evaluate.run_evaluate, "measure a trained network beside simple baselines"),
    (
        "make-default",
        make_default.add_make_default,
        make_default.run_make_default,
        "make the robot's default network: explore, label, train, calibrate, export",
    ),
    (
        "calibrate",
        calibrate.add_calibrate,
        calibrate.run_calibrate,
        "calibrate the confidence of an exported student on homes that it was not trained on",
    ),
    (
        "calibrate-camera",
        calibrate_camera.add_calibrate_camera,
        calibrate_camera.run_calibrate_camera,
        "measure the camera's intrinsics with a printed board, or take over those of ROS or Kalibr",
    ),
    (
        "watch",
        watch.add_watch,
        watch.run_watch,
        "train on recordings as pull-buffer brings them, and pass each network to a command",
    ),
    (
        "provenance",
        provenance.add_provenance,
        provenance.run_provenance,
        "say what a model was trained on, from which weights and for how many steps",
    ),
    ("export", export.add_export, export.run_export, "export a trained network as an ONNX file for the robot"),
)


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="embodied-depth", description=__doc__)
    commands = top.add_subparsers(dest="command", required=True)
    for name, add_options, run, help_text in COMMANDS:
        command = commands.add_parser(name, help=help_text, description=help_text)
        add_options(command)
        command.set_defaults(run_command=run)
    return top


def with_experiment(arguments: Sequence[str]) -> Sequence[str]:
    """Inserts the options of `--experiment FILE` right after the subcommand, so that typed options override them."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--experiment", type=Path)
    found, _ = finder.parse_known_args(arguments)
    return arguments if found.experiment is None else [arguments[0], *experiment.read(found.experiment), *arguments[1:]]


def main(arguments: Sequence[str] | None = None) -> int:
    try:
        options = parser().parse_args(with_experiment(sys.argv[1:] if arguments is None else arguments))
        options.run_command(options)
    except TrainerError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; run the same command again to continue from the last checkpoint", file=sys.stderr)
        return 130
    return 0
