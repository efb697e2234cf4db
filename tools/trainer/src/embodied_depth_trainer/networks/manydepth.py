"""ManyDepth (Watson et al. 2021) with metric poses: features of the image and a cost volume, with a single-frame
teacher for what matching cannot decide.

The volume compares colours instead of learnt features, because the robot computes it outside of the network; with
metric poses its planes are fixed. Where the volume's cheapest plane and the teacher differ by more than a factor of
two, something moves or has no texture: there the network learns the teacher's depth instead of minimising the
photometric error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from embodied_depth_trainer.networks.cost_volume import plane_depths
from embodied_depth_trainer.networks.monodepth2 import Monodepth2
from embodied_depth_trainer.networks.resnet import PYRAMID, Decoder, Encoder, Padding

PLANES = 96
VOLUME_RANGE_M = (0.3, 20.0)
# Share of samples whose earlier frames are static, and share of samples with an empty volume.
STILL_PROBABILITY = EMPTY_PROBABILITY = 0.25


class ManyDepth(nn.Module):
    """`rgb` [N, 3, H, W] in 0..1 and `volume` [N, 96, H / 4, W / 4] to x in 0..1 [N, 1, H, W]."""

    depths_m: Tensor

    def __init__(self, padding: Padding = "zeros") -> None:
        super().__init__()
        self.rgb = Encoder(3, (0.45,) * 3, (0.225,) * 3)
        self.join = nn.Sequential(nn.Conv2d(PYRAMID[1] + PLANES, PYRAMID[1], 3, padding=1), nn.ReLU())
        self.decoder = Decoder(PYRAMID, padding)
        # The teacher is used in training only: it is saved in checkpoints and left out of exports.
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
class VolumeAugmentation:
    """Samples of a batch [B] whose volume is made uninformative, so that the network also learns to do without."""

    still: NDArray[np.bool_] | None
    empty: NDArray[np.bool_] | None

    @staticmethod
    def none() -> VolumeAugmentation:
        return VolumeAugmentation(None, None)

    @staticmethod
    def draw(batch: int, random: np.random.Generator) -> VolumeAugmentation:
        chance = random.random(batch)
        still = chance < STILL_PROBABILITY
        return VolumeAugmentation(still, ~still & (chance < STILL_PROBABILITY + EMPTY_PROBABILITY))

    def of(self, mine: slice) -> VolumeAugmentation:
        still, empty = (None if samples is None else samples[mine] for samples in (self.still, self.empty))
        return VolumeAugmentation(still, empty)


def unreliable(volume: Tensor, depths_m: Tensor, teacher_m: Tensor) -> Tensor:
    """bool [B, 1, H, W]: the depth of the cheapest plane and the teacher's depth [B, 1, H, W] differ by more than a
    factor of 2, or the volume is empty."""
    cheapest = depths_m[volume.argmin(1, keepdim=True)]
    matched = F.interpolate(cheapest, size=teacher_m.shape[2:], mode="nearest")
    empty = F.interpolate(volume.amax(1, keepdim=True), size=teacher_m.shape[2:], mode="nearest") <= 0
    ratio = torch.maximum(matched / teacher_m, teacher_m / matched)
    return (ratio - 1 > 1) | empty


def teacher_error(depth_m: Tensor, teacher_m: Tensor, where: Tensor) -> Tensor:
    """Mean |depth - teacher's depth| / teacher's depth over `where`; no gradient flows to the teacher. Scalar."""
    error = (depth_m - teacher_m.detach()).abs() / teacher_m.detach()
    return (error * where).sum() / where.numel()
