"""The command line: `embodied-depth export-flow` and `embodied-depth export-depth`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .export_depth import DEPTH_NETWORKS, DepthExport, export_depth
from .export_flow import FLOW_NETWORKS, FlowExport, export_flow
from .onnx_file import ExportError


def picture_size(text: str) -> tuple[int, int]:
    """`192x640`: rows x columns, as the papers write it."""
    try:
        height, width = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not a size such as 192x640 (rows x columns)") from None
    if min(height, width) <= 0:
        raise argparse.ArgumentTypeError(f"`{text}` is empty; rows and columns are above 0")
    return height, width


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
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    options = parser().parse_args(arguments)
    try:
        if options.command == "export-flow":
            wish = FlowExport(
                options.network, options.size, options.iterations, options.weights, options.random, options.seed
            )
            error = export_flow(wish, options.out)
        else:
            low, high = options.depth_range
            depth = DepthExport(
                options.network,
                options.size,
                options.weights,
                options.random,
                options.padding,
                (low, high),
                options.seed,
            )
            error = export_depth(depth, options.out)
    except ExportError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 1
    print(f"{options.out}: ONNX Runtime differs from PyTorch by at most {error:.2e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
