"""Which of the target's points the source can see past the others."""

from __future__ import annotations

import torch
from torch import Tensor

from .warp import Projection

# A surface seen at a slant spreads over this much depth within one pixel; more is a surface behind another.
SLANT = 1.1


@torch.no_grad()
def visible(projection: Projection) -> Tensor:
    """bool [B, 1, H, W]: no other point of the target falls into the same pixel of the source clearly before it."""
    batch, height, width = projection.u.shape
    pixel = (projection.v.round() * width + projection.u.round()).long().view(batch, -1)
    # What is behind the source's camera hides nothing.
    depth_m = torch.where(projection.inside, projection.depth_m, torch.inf).view(batch, -1)
    nearest = torch.full_like(depth_m, torch.inf).scatter_reduce(1, pixel, depth_m, "amin")
    return (depth_m <= SLANT * nearest.gather(1, pixel)).view(batch, 1, height, width) & projection.inside
