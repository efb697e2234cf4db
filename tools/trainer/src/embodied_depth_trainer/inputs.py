"""What a network sees beside the picture."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .batches import coarse_planes
from .frames import Frames
from .manydepth import ManyDepth
from .volume import volume_planes


def second_input(
    network: nn.Module,
    frames: Frames,
    index: NDArray[np.int64],
    depth_range_m: tuple[float, float],
    device: torch.device | str = "cpu",
) -> Tensor:
    """Coarse depth, or the cost volume of a network that takes one."""
    if isinstance(network, ManyDepth):
        return volume_planes(frames, index, network.depths_m, device)
    return coarse_planes(frames, index, depth_range_m, device)
