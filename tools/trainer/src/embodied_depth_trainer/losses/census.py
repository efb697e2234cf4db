"""The soft census distance between two images (Meister et al. 2018, UnFlow).

It compares structure: gain, bias and slow shadows hardly change it.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

RADIUS = 3
# A neighbour counts as different at about this difference of 255; two signs count as different when their squared
# distance exceeds 0.1.
CONTRAST = 0.9 / 255
SOFTNESS = 0.1


def census(image: Tensor) -> Tensor:
    """The soft sign, in -1..1, of the difference of each of 48 neighbours from the pixel: [B, 48, H, W] of [B, 3, H,
    W]."""
    gray = image.mean(1, keepdim=True)
    height, width = gray.shape[2:]
    padded = F.pad(gray, (RADIUS,) * 4, mode="replicate")
    side = range(2 * RADIUS + 1)
    shifts = [(row, column) for row in side for column in side if (row, column) != (RADIUS, RADIUS)]
    difference = torch.cat([padded[:, :, r : r + height, c : c + width] for r, c in shifts], 1) - gray
    return difference / torch.sqrt(CONTRAST**2 + difference * difference)


def census_error(target: Tensor, warped: Tensor) -> Tensor:
    """Soft share of neighbours whose sign in `warped` [B, 3, H, W] differs from the target's census: [B, 1, H, W]."""
    squared = (census(warped) - target) ** 2
    return (squared / (SOFTNESS + squared)).mean(1, keepdim=True)
