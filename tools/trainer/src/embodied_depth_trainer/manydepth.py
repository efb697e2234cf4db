"""ManyDepth (Watson et al. 2021) with metric poses: a picture's own features and its cost volume, beside a single-frame
teacher for what matching cannot tell.

The volume compares colours, not learnt features, because that is what the robot computes outside of the network; with
metric poses its planes are fixed. Where the volume's cheapest plane and the teacher are further apart than a factor of
two, something moves or has no texture: there the teacher's depth is learnt instead of the photometric error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from .networks import PYRAMID, Decoder, Encoder, Monodepth2, Padding
from .volume import plane_depths

PLANES = 96
VOLUME_RANGE_M = (0.3, 20.0)
# How many samples see still earlier pictures, and how many an empty volume.
STILL_PROBABILITY = EMPTY_PROBABILITY = 0.25


class ManyDepth(nn.Module):
    """`rgb` [N, 3, H, W] in 0..1 and `volume` [N, 96, H / 4, W / 4] to x in 0..1 [N, 1, H, W]."""

    depths_m: Tensor

    def __init__(self, padding: Padding = "zeros") -> None:
        super().__init__()
        self.rgb = Encoder(3, (0.45,) * 3, (0.225,) * 3)
        self.join = nn.Sequential(nn.Conv2d(PYRAMID[1] + PLANES, PYRAMID[1], 3, padding=1), nn.ReLU())
        self.decoder = Decoder(PYRAMID, padding)
        # Only for training; it travels with the checkpoint and is in no export.
        self.teacher = Monodepth2(padding)
        self.register_buffer("depths_m", plane_depths(PLANES, VOLUME_RANGE_M), persistent=False)

    def forward(self, rgb: Tensor, volume: Tensor) -> Tensor:
        half = self.rgb.stem((rgb - self.rgb.mean) / self.rgb.std)
        first, *later = self.rgb.layers
        last = self.join(torch.cat([first(self.rgb.pool(half)), volume], 1))
        features = [half, last]
        for layer in later:
            last = layer(last)
            features.append(last)
        disparity: Tensor = self.decoder(features)
        return disparity


@dataclass(frozen=True)
class Disturbance:
    """Which samples of a batch [B] the volume says nothing about."""

    still: NDArray[np.bool_] | None
    empty: NDArray[np.bool_] | None

    @staticmethod
    def none() -> Disturbance:
        return Disturbance(None, None)

    @staticmethod
    def draw(batch: int, random: np.random.Generator) -> Disturbance:
        chance = random.random(batch)
        still = chance < STILL_PROBABILITY
        return Disturbance(still, ~still & (chance < STILL_PROBABILITY + EMPTY_PROBABILITY))


def untrustworthy(volume: Tensor, depths_m: Tensor, teacher_m: Tensor) -> Tensor:
    """bool [B, 1, H, W]: the cheapest plane and the teacher's depth [B, 1, H, W] are more than a factor of 2 apart, or
    the volume is empty."""
    cheapest = depths_m[volume.argmin(1, keepdim=True)]
    matched = F.interpolate(cheapest, size=teacher_m.shape[2:], mode="nearest")
    empty = F.interpolate(volume.amax(1, keepdim=True), size=teacher_m.shape[2:], mode="nearest") <= 0
    ratio = torch.maximum(matched / teacher_m, teacher_m / matched)
    return (ratio - 1 > 1) | empty


def consistency(depth_m: Tensor, teacher_m: Tensor, where: Tensor) -> Tensor:
    """Mean |depth - teacher's depth| / teacher's depth over `where`; no gradient for the teacher. Scalar."""
    error = (depth_m - teacher_m.detach()).abs() / teacher_m.detach()
    return (error * where).sum() / where.numel()
