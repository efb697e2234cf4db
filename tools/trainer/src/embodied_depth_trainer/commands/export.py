"""`embodied-depth export`, `export-depth` and `export-flow`: networks as ONNX files for the robot."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.commands.arguments import image_size
from embodied_depth_trainer.export.depth import DepthExport, export_checkpoint, export_depth
from embodied_depth_trainer.export.flow import FLOW_NETWORKS, FlowExport, export_flow
from embodied_depth_trainer.networks.registry import DEPTH_NETWORKS


def add_flow(command: argparse.ArgumentParser) -> None:
    command.add_argument("--network", choices=FLOW_NETWORKS, required=True)
    command.add_argument(
        "--weights", type=Path, help="weights file of torchvision or princeton-vl [download torchvision's weights]"
    )
    command.add_argument("--random", action="store_true", help="use random weights, for timing only")
    command.add_argument("--iterations", type=int, default=12, help="updates of the flow [12]")
    _add_shared(command)


def add_depth(command: argparse.ArgumentParser) -> None:
    command.add_argument("--network", choices=DEPTH_NETWORKS, required=True)
    command.add_argument("--weights", type=Path, help="state dict of this package's network")
    command.add_argument("--random", action="store_true", help="use random weights, for timing only")
    command.add_argument("--padding", choices=("zeros", "reflect"), default="zeros")
    command.add_argument("--depth-range", type=float, nargs=2, default=(0.1, 20.0), metavar=("MIN_M", "MAX_M"))
    _add_shared(command)


def _add_shared(command: argparse.ArgumentParser) -> None:
    command.add_argument("--size", type=image_size, default=(192, 640), help="rows x columns [192x640]")
    command.add_argument("--seed", type=int, default=0, help="seed of random weights and of the parity test's images")
    command.add_argument("--out", type=Path, required=True, help="ONNX file to write")


def add_export(command: argparse.ArgumentParser) -> None:
    command.add_argument("--checkpoint", type=Path, required=True, help="checkpoint.pt of a training")
    command.add_argument("--size", type=image_size, help="rows x columns of the robot's images [as in training]")
    command.add_argument("--out", type=Path, required=True, help="ONNX file to write")


def run_flow(options: argparse.Namespace) -> None:
    flow = FlowExport(options.network, options.size, options.iterations, options.weights, options.random, options.seed)
    report_parity(options.out, export_flow(flow, options.out))


def run_depth(options: argparse.Namespace) -> None:
    low, high = options.depth_range
    depth = DepthExport(
        options.network, options.size, options.weights, options.random, options.padding, (low, high), options.seed
    )
    report_parity(options.out, export_depth(depth, options.out))


def run_export(options: argparse.Namespace) -> None:
    report_parity(options.out, export_checkpoint(options.checkpoint, options.size, options.out))


def report_parity(file: Path, difference: float) -> None:
    print(f"{file}: ONNX Runtime differs from PyTorch by at most {difference:.2e}")
