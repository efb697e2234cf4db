"""Exports a depth network as an ONNX file with the metadata that the robot's `DepthNetwork` reads."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from embodied_depth_trainer.export.onnx_writer import ExportError, random_image, write_onnx
from embodied_depth_trainer.export.provenance import origin
from embodied_depth_trainer.networks.cost_volume import REDUCTION
from embodied_depth_trainer.networks.golden import golden_pair
from embodied_depth_trainer.networks.inputs import given_depth_of
from embodied_depth_trainer.networks.manydepth import PLANES, VOLUME_RANGE_M, ManyDepth
from embodied_depth_trainer.networks.registry import DEPTH_NETWORKS, SIZE_STEP, build_network, takes_coarse
from embodied_depth_trainer.networks.resnet import Padding
from embodied_depth_trainer.networks.state_dict import load_state_dict, load_strictly
from embodied_depth_trainer.training import checkpoint as checkpoints

__all__ = ["DEPTH_NETWORKS", "DepthExport", "build", "export_checkpoint", "export_depth"]


@dataclass(frozen=True)
class DepthExport:
    """A depth network to export."""

    network: str
    size: tuple[int, int]
    """Rows, columns."""
    weights: Path | None = None
    random: bool = False
    padding: Padding = "zeros"
    depth_range_m: tuple[float, float] = (0.1, 20.0)
    seed: int = 0


def build(request: DepthExport) -> nn.Module:
    """The network with its weights."""
    height, width = request.size
    if height % SIZE_STEP or width % SIZE_STEP:
        raise ExportError(
            f"the networks halve the size five times and cannot take {height}x{width}; give multiples of {SIZE_STEP}"
        )
    low, high = request.depth_range_m
    if not 0 < low < high:
        raise ExportError(f"the depth range {low} to {high} m is empty; give 0 < MIN_M < MAX_M")
    if request.random == (request.weights is not None):
        raise ExportError("give either --weights FILE or --random")
    network = build_network(request.network, request.depth_range_m, request.seed, request.padding)
    if request.weights is not None:
        load_strictly(network, load_state_dict(request.weights), str(request.weights))
    return network.eval()


def export_depth(request: DepthExport, out: Path) -> float:
    """Writes the ONNX file; returns the largest difference of x in 0..1 between ONNX Runtime and PyTorch."""
    provenance = {
        "padding": request.padding,
        "weights": "random" if request.weights is None else request.weights.name,
        "version": request.network,
    }
    return _export(build(request), request.network, request.size, request.depth_range_m, request.seed, provenance, out)


def export_checkpoint(file: Path, size: tuple[int, int] | None, out: Path) -> float:
    """Exports the network of a training, at its own image size unless another is given, with the training's settings
    in the metadata."""
    saved = checkpoints.load(file)
    height, width = size or (saved.camera.height, saved.camera.width)
    if height % SIZE_STEP or width % SIZE_STEP:
        raise ExportError(
            f"the networks halve the size five times and cannot take {height}x{width}; give multiples of {SIZE_STEP}"
        )
    camera = saved.camera.resized((height, width))
    provenance: dict[str, Any] = {
        # Intrinsics of the images as the network takes them; depth is z in `camera_optical`.
        "intrinsics": json.dumps({key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy")}),
        "weights": file.name,
        "training": json.dumps({"steps": saved.step, **saved.settings}, sort_keys=True),
        "version": f"{saved.network}-{saved.step}",
        **origin(saved),
    }
    if saved.past_frames is not None:
        # Marks the model: the robot computes coarse depth differently.
        provenance["coarse_from"] = f"{saved.past_frames.count} past frames, {saved.past_frames.gap} apart"
    return _export(saved.build(), saved.network, (height, width), saved.depth_range_m, 0, provenance, out)


def _export(
    network: nn.Module,
    name: str,
    size: tuple[int, int],
    depth_range_m: tuple[float, float],
    seed: int,
    provenance: dict[str, str],
    out: Path,
) -> float:
    height, width = size
    inputs: dict[str, Tensor] = {"rgb": random_image(size, seed)}
    if takes_coarse(network):
        coarse = random_image(size, seed + 1)
        # Validity is 0 or 1 on the robot.
        coarse[:, 1] = (coarse[:, 1] > 0.5).float()
        inputs["coarse"] = coarse
        provenance = {**provenance, "given_depth": given_depth_of(network)}
    if isinstance(network, ManyDepth):
        inputs["volume"] = 0.3 * torch.rand(
            1, PLANES, height // REDUCTION, width // REDUCTION, generator=torch.Generator().manual_seed(seed + 2)
        )
        near, far = VOLUME_RANGE_M
        provenance = {**provenance, "volume_min_depth_m": repr(near), "volume_max_depth_m": repr(far)}
    metadata = {
        "kind": "+".join(inputs),
        "output": "disparity",
        "min_depth_m": repr(depth_range_m[0]),
        "max_depth_m": repr(depth_range_m[1]),
        "input_width": str(width),
        "input_height": str(height),
        "architecture": name,
        **provenance,
        **golden_pair(network, inputs, size),
    }
    return write_onnx(network, inputs, "disparity", metadata, out)
