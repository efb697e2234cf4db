"""The loss that compares depth with what the safety LiDAR measured."""

from __future__ import annotations

import torch
from torch import Tensor

from embodied_depth_trainer import processes


def lidar_error(depth_m: Tensor, lines: Tensor) -> Tensor:
    """Mean |ln depth - ln z| over the pixels of the lines [B, 2, W] (row, z in metres, 0: none); `depth_m` is [B, 1,
    H, W] with the same W. The error is absolute, not squared, because some hits are occluded from the camera by
    objects above the scanner's plane. Scalar; 0 without any hit."""
    row, z = lines.unbind(1)
    valid = (z > 0).to(depth_m.dtype)
    predicted = depth_m[:, 0].gather(1, row.long().unsqueeze(1))[:, 0]
    error = (predicted.log() - torch.where(z > 0, z, 1.0).log()).abs()
    return (valid * error).sum() / processes.mean(valid.sum()).clamp(min=1.0)
