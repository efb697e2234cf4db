"""The command line: `embodied-depth loop`, `train`, `label`, `evaluate`, `export` and so on."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import torch

from . import experiment
from .arguments import picture_size
from .commands import run_calibrate, run_evaluate, run_label, run_train
from .default_network import make_default
from .errors import TrainerError
from .export_depth import DEPTH_NETWORKS, DepthExport, export_checkpoint, export_depth
from .export_flow import FLOW_NETWORKS, FlowExport, export_flow
from .fleet_command import add_fleet, run_fleet
from .loop_command import add_loop, run_loop_command
from .past_frames import GAP
from .results_command import add_jobs, add_results, run_jobs_command, run_results
from .robot import find_firmware_host
from .watch import WatchSettings, watch


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="embodied-depth", description=__doc__)
    commands = top.add_subparsers(dest="command", required=True)

    flow = commands.add_parser("export-flow", help="RAFT as an ONNX file for the robot's FlowNetwork")
    flow.add_argument("--network", choices=FLOW_NETWORKS, required=True)
    flow.add_argument("--weights", type=Path, help="torchvision's or princeton-vl's file; else torchvision's published")
    flow.add_argument("--random", action="store_true", help="random weights, for timing only")
    flow.add_argument("--iterations", type=int, default=12)

    depth = commands.add_parser("export-depth", help="a depth network as an ONNX file for the robot's DepthNetwork")
    depth.add_argument("--network", choices=DEPTH_NETWORKS, required=True)
    depth.add_argument("--weights", type=Path, help="state dict of this package's network")
    depth.add_argument("--random", action="store_true", help="random weights, for timing only")
    depth.add_argument("--padding", choices=("zeros", "reflect"), default="zeros")
    depth.add_argument("--depth-range", type=float, nargs=2, default=(0.1, 20.0), metavar=("MIN_M", "MAX_M"))

    for command in (flow, depth):
        command.add_argument("--size", type=picture_size, default=(192, 640), help="rows x columns [192x640]")
        command.add_argument("--seed", type=int, default=0, help="of random weights and of the parity pictures")
        command.add_argument("--out", type=Path, required=True)

    label = commands.add_parser("label", help="what a whole recording knows of the depth of each of its pictures")
    label.add_argument("--recording", type=Path, required=True, help="--out folder of a run")
    label.add_argument("--coarse", type=Path, required=True, help="what `firmware-host perceive --dump` wrote of it")
    label.add_argument("--out", type=Path, required=True, help="file to write (.npz)")
    _add_train(commands.add_parser("train", help="train a depth network on recordings, without any depth sensor"))
    add_loop(commands.add_parser("loop", help="explore, train, hand over, explore on: the paper's algorithm 1"))
    add_fleet(commands.add_parser("fleet", help="one network from the recordings of many homes, by policy and network"))
    add_jobs(commands.add_parser("jobs", help="print a job file: every network x policy x scene x seed"))
    add_results(commands.add_parser("results", help="tables and figures of many loops"))
    _add_evaluate(commands.add_parser("evaluate", help="how right a trained network is, beside what is trivial"))
    default = commands.add_parser("make-default", help="the robot's default network, from nothing")
    default.add_argument("--robot", type=Path, required=True, help="firmware-host, a release build")
    default.add_argument("--work", type=Path, required=True, help="folder for runs and training; 10 GB")
    default.add_argument("--threads", type=int, default=1, help="of the CPU [1]")
    default.add_argument("--out", type=Path, required=True)
    calibrated = commands.add_parser(
        "calibrate", help="make an exported student promise no more than it keeps in further homes"
    )
    calibrated.add_argument("--model", type=Path, required=True, help="ONNX file of a student")
    for name in ("--recording", "--coarse", "--labels"):
        calibrated.add_argument(name, type=Path, action="append", required=True, help="as of `train`; may be repeated")
    calibrated.add_argument("--every", type=int, default=1, help="every Nth picture only [1]")
    calibrated.add_argument("--out", type=Path, required=True)
    _add_watch(
        commands.add_parser("watch", help="train on what pull-buffer brings, as it comes, and hand each network on")
    )
    trained = commands.add_parser("export", help="a trained network as an ONNX file for the robot")
    trained.add_argument("--checkpoint", type=Path, required=True, help="checkpoint.pt of a training")
    trained.add_argument(
        "--size", type=picture_size, help="rows x columns of the robot's camera [those of the training]"
    )
    trained.add_argument("--out", type=Path, required=True)
    return top


def _add_frames(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--recording", type=Path, action="append", default=[], help="--out folder of a run; may be repeated"
    )
    command.add_argument(
        "--coarse", type=Path, action="append", default=[], help="what `firmware-host perceive --dump` wrote of it"
    )
    command.add_argument(
        "--dataset", type=Path, action="append", default=[], help="what `perceive --dataset --dump` wrote"
    )
    command.add_argument("--every", type=int, default=1, help="every Nth picture of a recording only [1]")
    command.add_argument("--size", type=picture_size, help="rows x columns to reduce the pictures to")
    command.add_argument("--device", default="cpu", help="cpu or cuda [cpu]")
    command.add_argument(
        "--threads", type=int, default=1, help="of the CPU; more help only where nothing else runs [1]"
    )


def _add_train(command: argparse.ArgumentParser) -> None:
    _add_frames(command)
    command.add_argument("--network", choices=DEPTH_NETWORKS, default="student")
    command.add_argument(
        "--steps", type=int, required=True, help="in all; a training in --out goes on from where it is"
    )
    command.add_argument("--out", type=Path, required=True)
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--batch", type=int, default=12)
    command.add_argument("--learning-rate", type=float, default=1e-4, help="of Adam [1e-4]")
    command.add_argument(
        "--encoder",
        metavar="FILE",
        help="what the ResNet18 that sees pictures begins with: torchvision's state dict, or `imagenet` to fetch it "
        "[random]",
    )
    command.add_argument("--amp", action="store_true", help="bfloat16: where AMX or a GPU computes with it")
    command.add_argument("--experiment", type=Path, help="TOML file of these options; what is typed here wins")
    command.add_argument("--tensorboard", action="store_true", help="write OUT/tensorboard")
    command.add_argument("--buffer", type=int, metavar="PICTURES", help="learn from so many at most [all]")
    command.add_argument("--keep", choices=("newest", "poses"), default="newest", help="which, if there are more")
    command.add_argument("--checkpoint-every", type=int, default=200, metavar="STEPS")
    command.add_argument(
        "--baseline", type=float, nargs=2, default=(0.05, 0.30), metavar=("MIN_M", "MAX_M"), help="of pairs [0.05 0.30]"
    )
    command.add_argument("--gap", type=int, help="instead: pairs this many frames apart, as the paper's (4 or 15)")
    command.add_argument(
        "--past-frames", type=int, default=0, choices=(0, 1, 2), help="coarse depth from so many, as the paper's [0]"
    )
    command.add_argument("--past-gap", type=int, default=GAP, help=f"frames from one to the next [{GAP}]")
    command.add_argument("--depth-range", type=float, nargs=2, default=(0.1, 20.0), metavar=("MIN_M", "MAX_M"))
    command.add_argument("--smoothness", type=float, help="weight [1e-3; sc_depth_r18: 0.1]")
    command.add_argument("--geometry", type=float, help="weight of the geometry consistency [0; sc_depth_r18: 0.5]")
    command.add_argument("--coarse-weight", type=float, default=0.1, help="weight of agreeing with coarse depth [0.1]")
    command.add_argument(
        "--labels", type=Path, action="append", default=[], help="what `label` wrote; one for each --recording"
    )
    command.add_argument("--label-weight", type=float, default=1.0, help="of agreeing with --labels [1]")
    command.add_argument(
        "--lidar-weight", type=float, default=0.0, help="of agreeing with the LiDAR along its line [0: no depth sensor]"
    )
    command.add_argument("--photometric-weight", type=float, default=1.0, help="of the photometric loss [1]")
    command.add_argument("--crop-width", type=int, default=0, help="columns of a target that a step sees [all]")
    command.add_argument(
        "--decay-from", type=int, metavar="STEP", help="where the learning rate begins to go down to 0 at --steps"
    )
    command.add_argument("--uncertainty-weight", type=float, default=0.05, help="of learning the own error [0.05]")
    command.add_argument(
        "--auto-mask", action=argparse.BooleanOptionalAction, help="as in the paper's code [only sc_depth_r18]"
    )
    command.add_argument("--visibility", action="store_true", help="leave out points that others hide from the source")
    command.add_argument("--census", action="store_true", help="compare structure instead of colours")
    command.add_argument(
        "--teacher-steps", type=int, default=2000, help="manydepth_r18: its teacher learns so long [2000]"
    )
    command.add_argument("--no-exposure", action="store_true", help="do not fit gain and bias of a pair")
    command.add_argument("--no-augmentation", action="store_true", help="neither change colours nor cut holes")


def _add_watch(command: argparse.ArgumentParser) -> None:
    command.add_argument("--pulled", type=Path, required=True, help="folder that pull-buffer fills")
    command.add_argument("--work", type=Path, required=True, help="what was done; a watch in it goes on from there")
    command.add_argument("--firmware-host", type=Path, metavar="FILE", help="the robot's program [on the PATH]")
    usual = WatchSettings(Path(), Path(), Path())
    command.add_argument(
        "--pictures", type=int, default=usual.pictures, help=f"so many new ones begin a round [{usual.pictures}]"
    )
    command.add_argument("--steps", type=int, default=usual.steps, help=f"of training a round [{usual.steps}]")
    command.add_argument("--rounds", type=int, help="ends after so many [never]")
    command.add_argument("--then", metavar="COMMAND", help="run with each network: 'push-model {} robot.local'")
    command.add_argument("--threads", type=int, default=1, help="of the CPU [1]")


def _add_evaluate(command: argparse.ArgumentParser) -> None:
    _add_frames(command)
    command.add_argument("--checkpoint", type=Path, help="of a training; without one, only what is trivial")
    command.add_argument(
        "--views", type=Path, help="instead: what `firmware-host views` wrote; also says what is right after a turn"
    )
    command.add_argument("--json", type=Path, help="also write the numbers here")


def with_experiment(arguments: Sequence[str]) -> Sequence[str]:
    """With the options of `--experiment FILE` after the command, so that those that were typed win."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--experiment", type=Path)
    found, _ = finder.parse_known_args(arguments)
    return arguments if found.experiment is None else [arguments[0], *experiment.read(found.experiment), *arguments[1:]]


def main(arguments: Sequence[str] | None = None) -> int:
    try:
        options = parser().parse_args(with_experiment(sys.argv[1:] if arguments is None else arguments))
        if options.command == "train":
            run_train(options)
        elif options.command == "label":
            run_label(options)
        elif options.command == "loop":
            run_loop_command(options)
        elif options.command == "fleet":
            run_fleet(options)
        elif options.command == "jobs":
            run_jobs_command(options)
        elif options.command == "results":
            run_results(options)
        elif options.command == "watch":
            _watch(options)
        elif options.command == "calibrate":
            run_calibrate(options)
        elif options.command == "evaluate":
            run_evaluate(options)
        else:
            error = _export(options)
            print(f"{options.out}: ONNX Runtime differs from PyTorch by at most {error:.2e}")
    except TrainerError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0


def _watch(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    watch(
        WatchSettings(
            pulled=options.pulled,
            work=options.work,
            robot=find_firmware_host(options.firmware_host),
            pictures=options.pictures,
            steps=options.steps,
            then=options.then,
            rounds=options.rounds,
        )
    )


def _export(options: argparse.Namespace) -> float:
    if options.command == "make-default":
        torch.set_num_threads(options.threads)
        return make_default(options.robot, options.work, options.out)
    if options.command == "export":
        return export_checkpoint(options.checkpoint, options.size, options.out)
    if options.command == "export-flow":
        flow = FlowExport(
            options.network, options.size, options.iterations, options.weights, options.random, options.seed
        )
        return export_flow(flow, options.out)
    low, high = options.depth_range
    depth = DepthExport(
        options.network, options.size, options.weights, options.random, options.padding, (low, high), options.seed
    )
    return export_depth(depth, options.out)


if __name__ == "__main__":
    sys.exit(main())
