"""RAFT (Teed and Deng 2020) as an ONNX file: two RGB pictures in 0..1 in, flow in pixels out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.error import URLError

import torch
from torch import Tensor, nn
from torchvision.models.optical_flow import Raft_Large_Weights, Raft_Small_Weights, raft_large, raft_small

from .onnx_file import ExportError, load_state_dict, load_strictly, random_picture, write_onnx
from .raft_weights import from_princeton, is_princeton

FLOW_NETWORKS = ("raft_small", "raft_large")
# Features at 1/8 size, halved three times for the correlation pyramid, at least 2 pixels at its top.
MIN_SIDE = 128
# Motion in the pictures that ONNX Runtime and PyTorch are compared on: x, y.
MOTION_PX = (5, 3)


@dataclass(frozen=True)
class FlowExport:
    """What to export."""

    network: str
    size: tuple[int, int]
    """Rows, columns."""
    iterations: int = 12
    weights: Path | None = None
    random: bool = False
    seed: int = 0


class FlowGraph(nn.Module):
    """RAFT and its pre-processing: pictures `[1, 3, H, W]` in 0..1, flow `[1, 2, H, W]` from first to second."""

    def __init__(self, raft: nn.Module, iterations: int) -> None:
        super().__init__()
        self.raft = raft
        self.iterations = iterations

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        flows = self.raft(2.0 * image1 - 1.0, 2.0 * image2 - 1.0, num_flow_updates=self.iterations)
        last: Tensor = flows[-1]
        return last


def build(wish: FlowExport) -> tuple[FlowGraph, str]:
    """The network with its weights, and where they came from."""
    height, width = wish.size
    if height % 8 or width % 8 or min(height, width) < MIN_SIDE:
        raise ExportError(f"RAFT cannot take {height}x{width}; give multiples of 8, at least {MIN_SIDE}")
    if wish.iterations < 1:
        raise ExportError(f"{wish.iterations} iterations give no flow; give at least 1")
    if wish.random and wish.weights is not None:
        raise ExportError("--random and --weights contradict each other; give one")
    torch.manual_seed(wish.seed)
    raft: nn.Module = (raft_small if wish.network == "raft_small" else raft_large)(weights=None)
    source = _load(raft, wish)
    return FlowGraph(raft, wish.iterations).eval(), source


def _load(raft: nn.Module, wish: FlowExport) -> str:
    if wish.random:
        return "random"
    if wish.weights is not None:
        weights = load_state_dict(wish.weights)
        if is_princeton(weights):
            load_strictly(raft, from_princeton(weights), str(wish.weights))
            return f"princeton-vl {wish.weights.name}"
        load_strictly(raft, weights, str(wish.weights))
        return f"torchvision {wish.weights.name}"
    published = Raft_Small_Weights.DEFAULT if wish.network == "raft_small" else Raft_Large_Weights.DEFAULT
    try:
        raft.load_state_dict(published.get_state_dict(progress=False, check_hash=True))
    except (URLError, OSError) as problem:
        raise ExportError(
            f"torchvision's weights {published} cannot be fetched ({problem}); give --weights FILE or --random"
        ) from problem
    return f"torchvision {published}"


def moved_pictures(size: tuple[int, int], seed: int) -> tuple[Tensor, Tensor]:
    """A picture and the same moved by `MOTION_PX`: on pictures that have nothing in common, flow is chaotic."""
    height, width = size
    dx, dy = MOTION_PX
    scene = random_picture((height + dy, width + dx), seed)
    return scene[..., dy:, dx:].contiguous(), scene[..., :height, :width].contiguous()


def export_flow(wish: FlowExport, out: Path) -> float:
    """Writes the ONNX file; returns the largest difference between ONNX Runtime and PyTorch, pixels."""
    graph, source = build(wish)
    first, second = moved_pictures(wish.size, wish.seed)
    height, width = wish.size
    metadata = {
        "kind": "flow",
        "input_range": "0..1",
        "input_width": str(width),
        "input_height": str(height),
        "architecture": wish.network,
        "iterations": str(wish.iterations),
        "weights": source,
        "version": f"{wish.network}-{wish.iterations}",
    }
    return write_onnx(graph, {"image1": first, "image2": second}, "flow", metadata, out)
