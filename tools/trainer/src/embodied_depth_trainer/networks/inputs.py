"""The second input of a network, besides the image."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from embodied_depth_trainer.data.batches import coarse_planes
from embodied_depth_trainer.data.frame_set import FrameSet, GivenDepth, giving
from embodied_depth_trainer.networks.cost_volume import volume_planes
from embodied_depth_trainer.networks.manydepth import ManyDepth
from embodied_depth_trainer.networks.runtime import OnnxNetwork


def second_input(
    network: nn.Module,
    frames: FrameSet,
    index: NDArray[np.int64],
    depth_range_m: tuple[float, float],
    device: torch.device | str = "cpu",
) -> Tensor:
    """The depth that the network is given, or the cost volume for a network that takes one."""
    # ManyDepth, also as an ONNX file.
    depths_m = network.depths_m if isinstance(network, ManyDepth | OnnxNetwork) else None
    if depths_m is not None:
        return volume_planes(frames, index, depths_m, device)
    return coarse_planes(giving(frames, given_depth_of(network)), index, depth_range_m, device)


def give(network: nn.Module, depth: GivenDepth) -> nn.Module:
    """The same network, which is given this depth from now on."""
    network.given_depth = depth  # type: ignore[assignment]
    return network


def given_depth_of(network: nn.Module) -> GivenDepth:
    """The depth that the network is given."""
    return "dense" if getattr(network, "given_depth", "coarse") == "dense" else "coarse"
