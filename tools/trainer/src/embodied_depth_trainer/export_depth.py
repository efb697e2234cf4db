"""A depth network as an ONNX file with the metadata that the robot's `DepthNetwork` reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from .networks import Edn, Monodepth2, Padding
from .onnx_file import ExportError, load_state_dict, load_strictly, random_picture, write_onnx

DEPTH_NETWORKS = ("monodepth2_r18", "edn_r18", "edn_r18_concat")


@dataclass(frozen=True)
class DepthExport:
    """What to export."""

    network: str
    size: tuple[int, int]
    """Rows, columns."""
    weights: Path | None = None
    random: bool = False
    padding: Padding = "zeros"
    depth_range_m: tuple[float, float] = (0.1, 20.0)
    seed: int = 0


def build(wish: DepthExport) -> nn.Module:
    """The network with its weights."""
    height, width = wish.size
    if height % 32 or width % 32:
        raise ExportError(f"ResNet18 halves five times and cannot take {height}x{width}; give multiples of 32")
    low, high = wish.depth_range_m
    if not 0 < low < high:
        raise ExportError(f"the depth range {low} to {high} m is empty; give 0 < MIN_M < MAX_M")
    if wish.random == (wish.weights is not None):
        raise ExportError("give either --weights FILE or --random")
    torch.manual_seed(wish.seed)
    network: nn.Module
    if wish.network == "monodepth2_r18":
        network = Monodepth2(wish.padding)
    else:
        network = Edn("concat" if wish.network.endswith("concat") else "add", wish.padding)
    if wish.weights is not None:
        load_strictly(network, load_state_dict(wish.weights), str(wish.weights))
    return network.eval()


def export_depth(wish: DepthExport, out: Path) -> float:
    """Writes the ONNX file; returns the largest difference of x in 0..1 between ONNX Runtime and PyTorch."""
    network = build(wish)
    height, width = wish.size
    inputs: dict[str, Tensor] = {"rgb": random_picture(wish.size, wish.seed)}
    if isinstance(network, Edn):
        inputs["coarse"] = random_picture(wish.size, wish.seed + 1)
    metadata = {
        "kind": "+".join(inputs),
        "output": "disparity",
        "min_depth_m": repr(wish.depth_range_m[0]),
        "max_depth_m": repr(wish.depth_range_m[1]),
        "input_width": str(width),
        "input_height": str(height),
        "architecture": wish.network,
        "padding": wish.padding,
        "weights": "random" if wish.weights is None else wish.weights.name,
        "version": wish.network,
    }
    return write_onnx(network, inputs, "disparity", metadata, out)
