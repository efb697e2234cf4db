"""Photometric self-supervision: what training minimises.

Pictures are RGB in 0..1, `[B, 3, H, W]`; depths z in metres, `[B, 1, H, W]`; errors and masks `[B, 1, H, W]`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from . import processes
from .census import census, census_error
from .photometric import Patches, photometric_error
from .visibility import visible
from .warp import Projection

# A camera's automatic exposure changes by less than this between two neighbouring pictures.
GAIN_LIMITS = (0.5, 2.0)
# Breaks ties of the auto-mask on pixels that look the same in both pictures.
AUTO_MASK_NOISE = 1e-5


def same_exposure(target: Tensor, warped: Tensor, inside: Tensor) -> Tensor:
    """`warped` with the gain and bias, one pair a picture, that bring it closest to `target` in least squares over the
    pixels `inside`. No gradient flows through gain and bias: depth must not profit from a wrong exposure."""
    with torch.no_grad():
        weight = inside.to(warped.dtype)
        count = 3 * weight.sum((1, 2, 3)).clamp(min=1.0)

        def mean(x: Tensor) -> Tensor:
            return ((x * weight).sum((1, 2, 3)) / count).view(-1, 1, 1, 1)

        mean_target, mean_warped = mean(target), mean(warped)
        centred = warped - mean_warped
        # A picture without contrast says nothing about gain; the small number keeps 1 there.
        tiny = 1e-6
        gain = (mean(centred * (target - mean_target)) + tiny) / (mean(centred * centred) + tiny)
        gain = gain.clamp(*GAIN_LIMITS)
        bias = mean_target - gain * mean_warped
    return gain * warped + bias


def smoothness(disparity: Tensor, picture: Tensor) -> Tensor:
    """Steps of the mean-normalised disparity, allowed at steps of the picture. Scalar."""
    normal = disparity / disparity.mean((2, 3), keepdim=True).clamp(min=1e-7)

    def along(dim: int) -> Tensor:
        step = normal.diff(dim=dim).abs()
        return (step * torch.exp(-picture.diff(dim=dim).abs().mean(1, keepdim=True))).mean()

    return along(3) + along(2)


def geometry_inconsistency(projection: Projection, source_depth_m: Tensor) -> Tensor:
    """|z - z'| / (z + z') in 0..1 between a point's depth in the source camera and the depth that the source picture
    itself says there (Bian et al. 2019, SC-SfMLearner)."""
    said = projection.sample(source_depth_m)
    computed = projection.depth_m.clamp(min=1e-3)
    return (computed - said).abs() / (computed + said)


@dataclass(frozen=True)
class LossOptions:
    """What the loss is made of. The defaults are for known poses: see the trainer's README."""

    smoothness: float = 1e-3
    geometry: float = 0.0
    """Weight of the geometry inconsistency; above 0 it also fades out occluded pixels."""
    auto_mask: bool = False
    """Leaves out pixels that fit better unwarped (Monodepth2). With known poses standstill is known, and small
    baselines make it remove just the pixels that have no other supervision."""
    exposure: bool = True
    """Brings the warped picture to the target's gain and bias first."""
    both_ways: bool = False
    """Sources are explained by the target as well, and their depth learns from it (SC-Depth)."""
    visibility: bool = False
    """Leaves out points that another point hides from the source."""
    census: bool = False
    """Compares structure instead of colours: for lights that change."""


@dataclass(frozen=True)
class View:
    """One source of a target."""

    picture: Tensor
    projection: Projection
    depth_m: Tensor | None = None
    """What the network says about the source, for the geometry."""


def self_supervision(
    picture: Tensor,
    disparity: Tensor,
    views: Sequence[View],
    options: LossOptions,
    generator: torch.Generator | None = None,
    only: Tensor | None = None,
) -> Tensor:
    """The scalar loss: the photometric error of the best source of every pixel that some source sees (of those in
    `only`, bool [B, 1, H, W]), and smoothness."""
    error_of = _error_to(picture, options)
    errors: list[Tensor] = []
    insides: list[Tensor] = []
    geometry = disparity.new_zeros(())
    for view in views:
        warped = view.projection.sample(view.picture)
        inside = visible(view.projection) if options.visibility else view.projection.inside
        if options.exposure:
            warped = same_exposure(picture, warped, inside)
        error = error_of(warped)
        if options.geometry > 0 and view.depth_m is not None:
            inconsistency = geometry_inconsistency(view.projection, view.depth_m)
            error = error * (1 - inconsistency.detach())
            geometry = geometry + _mean_where(inconsistency, inside) / len(views)
        errors.append(error)
        insides.append(inside)
    error = torch.cat(errors, 1)
    with torch.no_grad():
        least, best = torch.where(torch.cat(insides, 1), error, torch.inf).min(1, keepdim=True)
        counts = torch.isfinite(least)
        if only is not None:
            counts = counts & only
        if options.auto_mask:
            still = functools.reduce(torch.minimum, [error_of(view.picture) for view in views])
            noise = torch.randn(still.shape, generator=generator, dtype=still.dtype).to(still.device)
            counts = counts & (least < still + AUTO_MASK_NOISE * noise)
        # 1 at the best source of every pixel that counts.
        chosen = torch.zeros_like(error).scatter_(1, best, counts.to(error.dtype))
    loss = (error * chosen).sum() / processes.mean(counts.sum().float()).clamp(min=1) + options.smoothness * smoothness(
        disparity, picture
    )
    return loss + options.geometry * geometry


def _error_to(picture: Tensor, options: LossOptions) -> Callable[[Tensor], Tensor]:
    """The error [B, 1, H, W] of a warped picture; what belongs to the target is computed once."""
    if options.census:
        signs = census(picture)
        return lambda warped: census_error(signs, warped)
    patches = Patches.of(picture)
    return lambda warped: photometric_error(patches, warped)


def _mean_where(values: Tensor, mask: Tensor) -> Tensor:
    """Mean over a mask; 0 where it is empty. The masked-out values may be infinite."""
    return torch.where(mask, values, 0.0).sum() / processes.mean(mask.sum().float()).clamp(min=1)
