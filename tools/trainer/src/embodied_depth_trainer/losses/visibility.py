"""Finds the points of the target that are not occluded in the source."""

from __future__ import annotations

import torch
from torch import Tensor

from embodied_depth_trainer.data.projection import Projection

# A slanted surface spreads over this ratio of depths within one pixel; a larger ratio is a second surface.
SLANT = 1.1


@torch.no_grad()
def visible(projection: Projection) -> Tensor:
    """bool [B, 1, H, W]: no other point of the target falls into the same source pixel clearly in front of it."""
    batch, height, width = projection.u.shape
    pixel = (projection.v.round() * width + projection.u.round()).long().view(batch, -1)
    # Points behind the source's camera occlude nothing.
    depth_m = torch.where(projection.inside, projection.depth_m, torch.inf).view(batch, -1)
    nearest = torch.full_like(depth_m, torch.inf).scatter_reduce(1, pixel, depth_m, "amin")
    return (depth_m <= SLANT * nearest.gather(1, pixel)).view(batch, 1, height, width) & projection.inside
