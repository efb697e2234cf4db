"""The command line: `embodied-depth loop`, `train`, `evaluate`, `export` and so on."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .arguments import picture_size
from .commands import run_evaluate, run_train
from .errors import TrainerError
from .export_depth import DEPTH_NETWORKS, DepthExport, export_checkpoint, export_depth
from .export_flow import FLOW_NETWORKS, FlowExport, export_flow
from .loop_command import add_loop, run_loop_command
from .results_command import add_jobs, add_results, run_jobs_command, run_results


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

    _add_train(commands.add_parser("train", help="train a depth network on recordings, without any depth sensor"))
    add_loop(commands.add_parser("loop", help="explore, train, hand over, explore on: the paper's algorithm 1"))
    add_jobs(commands.add_parser("jobs", help="print a job file: every network x policy x scene x seed"))
    add_results(commands.add_parser("results", help="tables and figures of many loops"))
    _add_evaluate(commands.add_parser("evaluate", help="how right a trained network is, beside what is trivial"))
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
    command.add_argument("--checkpoint-every", type=int, default=200, metavar="STEPS")
    command.add_argument(
        "--baseline", type=float, nargs=2, default=(0.05, 0.30), metavar=("MIN_M", "MAX_M"), help="of pairs [0.05 0.30]"
    )
    command.add_argument("--gap", type=int, help="instead: pairs this many frames apart, as the paper's (4 or 15)")
    command.add_argument("--depth-range", type=float, nargs=2, default=(0.1, 20.0), metavar=("MIN_M", "MAX_M"))
    command.add_argument("--smoothness", type=float, default=1e-3, help="weight [1e-3]")
    command.add_argument("--geometry", type=float, default=0.0, help="weight of the geometry consistency [0]")
    command.add_argument("--coarse-weight", type=float, default=0.1, help="weight of agreeing with coarse depth [0.1]")
    command.add_argument("--uncertainty-weight", type=float, default=0.05, help="of learning the own error [0.05]")
    command.add_argument("--auto-mask", action="store_true", help="as in the paper's code")
    command.add_argument("--no-exposure", action="store_true", help="do not fit gain and bias of a pair")
    command.add_argument("--no-augmentation", action="store_true", help="neither change colours nor cut holes")


def _add_evaluate(command: argparse.ArgumentParser) -> None:
    _add_frames(command)
    command.add_argument("--checkpoint", type=Path, help="of a training; without one, only what is trivial")
    command.add_argument("--json", type=Path, help="also write the numbers here")


def main(arguments: Sequence[str] | None = None) -> int:
    options = parser().parse_args(arguments)
    try:
        if options.command == "train":
            run_train(options)
        elif options.command == "loop":
            run_loop_command(options)
        elif options.command == "jobs":
            run_jobs_command(options)
        elif options.command == "results":
            run_results(options)
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


def _export(options: argparse.Namespace) -> float:
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
