"""How unlike two pictures' structure is: the soft census distance (Meister et al. 2018, UnFlow), which neither gain nor
bias nor a slow shadow changes much."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

RADIUS = 3
# A neighbour differs when it differs by about this, of 255; two signs differ when their distance squared is above 0.1.
CONTRAST = 0.9 / 255
SOFTNESS = 0.1


def census(picture: Tensor) -> Tensor:
    """How each of the 48 neighbours differs from the pixel, in -1..1: [B, 48, H, W] of [B, 3, H, W]."""
    grey = picture.mean(1, keepdim=True)
    height, width = grey.shape[2:]
    padded = F.pad(grey, (RADIUS,) * 4, mode="replicate")
    side = range(2 * RADIUS + 1)
    shifts = [(row, column) for row in side for column in side if (row, column) != (RADIUS, RADIUS)]
    difference = torch.cat([padded[:, :, r : r + height, c : c + width] for r, c in shifts], 1) - grey
    return difference / torch.sqrt(CONTRAST**2 + difference * difference)


def census_error(target: Tensor, warped: Tensor) -> Tensor:
    """Share of neighbours that differ otherwise in `warped` [B, 3, H, W] than in `target`'s census: [B, 1, H, W]."""
    squared = (census(warped) - target) ** 2
    return (squared / (SOFTNESS + squared)).mean(1, keepdim=True)
