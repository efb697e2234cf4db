"""Exports RAFT (Teed and Deng 2020) as an ONNX file: two RGB images in 0..1 in, flow in pixels out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.error import URLError

import torch
from torch import Tensor, nn
from torchvision.models.optical_flow import Raft_Large_Weights, Raft_Small_Weights, raft_large, raft_small

from embodied_depth_trainer.export.onnx_writer import ExportError, random_image, write_onnx
from embodied_depth_trainer.export.raft_weights import from_princeton, is_princeton
from embodied_depth_trainer.networks.state_dict import load_state_dict, load_strictly

FLOW_NETWORKS = ("raft_small", "raft_large")
# Features are at 1/8 of the size and halved three times for the correlation pyramid, whose top needs 2 pixels.
MIN_SIDE = 128
# Motion between the two images on which ONNX Runtime and PyTorch are compared: x, y.
MOTION_PX = (5, 3)


@dataclass(frozen=True)
class FlowExport:
    """A flow network to export."""

    network: str
    size: tuple[int, int]
    """Rows, columns."""
    iterations: int = 12
    weights: Path | None = None
    random: bool = False
    seed: int = 0


class FlowGraph(nn.Module):
    """RAFT and pre-processing: images `[1, 3, H, W]` in 0..1 to flow `[1, 2, H, W]` from the first to the second."""

    def __init__(self, raft: nn.Module, iterations: int) -> None:
        super().__init__()
        self.raft = raft
        self.iterations = iterations

    def forward(self, image1: Tensor, image2: Tensor) -> Tensor:
        flows = self.raft(2.0 * image1 - 1.0, 2.0 * image2 - 1.0, num_flow_updates=self.iterations)
        last: Tensor = flows[-1]
        return last


def build(request: FlowExport) -> tuple[FlowGraph, str]:
    """The network with its weights, and where they came from."""
    height, width = request.size
    if height % 8 or width % 8 or min(height, width) < MIN_SIDE:
        raise ExportError(f"RAFT cannot take {height}x{width}; give multiples of 8, at least {MIN_SIDE}")
    if request.iterations < 1:
        raise ExportError(f"{request.iterations} iterations give no flow; give at least 1")
    if request.random and request.weights is not None:
        raise ExportError("--random and --weights contradict each other; give one")
    torch.manual_seed(request.seed)
    raft: nn.Module = (raft_small if request.network == "raft_small" else raft_large)(weights=None)
    source = _load(raft, request)
    return FlowGraph(raft, request.iterations).eval(), source


def _load(raft: nn.Module, request: FlowExport) -> str:
    if request.random:
        return "random"
    if request.weights is not None:
        weights = load_state_dict(request.weights)
        if is_princeton(weights):
            load_strictly(raft, from_princeton(weights), str(request.weights))
            return f"princeton-vl {request.weights.name}"
        load_strictly(raft, weights, str(request.weights))
        return f"torchvision {request.weights.name}"
    published = Raft_Small_Weights.DEFAULT if request.network == "raft_small" else Raft_Large_Weights.DEFAULT
    try:
        raft.load_state_dict(published.get_state_dict(progress=False, check_hash=True))
    except (URLError, OSError) as problem:
        raise ExportError(
            f"torchvision's weights {published} cannot be downloaded ({problem}); give --weights FILE or --random"
        ) from problem
    return f"torchvision {published}"


def shifted_images(size: tuple[int, int], seed: int) -> tuple[Tensor, Tensor]:
    """An image and a copy shifted by `MOTION_PX`: on images without anything in common, flow is chaotic."""
    height, width = size
    dx, dy = MOTION_PX
    scene = random_image((height + dy, width + dx), seed)
    return scene[..., dy:, dx:].contiguous(), scene[..., :height, :width].contiguous()


def export_flow(request: FlowExport, out: Path) -> float:
    """Writes the ONNX file; returns the largest difference between ONNX Runtime and PyTorch, pixels."""
    graph, source = build(request)
    first, second = shifted_images(request.size, request.seed)
    height, width = request.size
    metadata = {
        "kind": "flow",
        "input_range": "0..1",
        "input_width": str(width),
        "input_height": str(height),
        "architecture": request.network,
        "iterations": str(request.iterations),
        "weights": source,
        "version": f"{request.network}-{request.iterations}",
    }
    return write_onnx(graph, {"image1": first, "image2": second}, "flow", metadata, out)
