"""Photometric self-supervision by the minimum reprojection error (Godard et al. 2019).

Images are RGB in 0..1, `[B, 3, H, W]`; depths z in metres, `[B, 1, H, W]`; errors and masks `[B, 1, H, W]`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from embodied_depth_trainer import processes
from embodied_depth_trainer.data.projection import Projection
from embodied_depth_trainer.losses.census import census, census_error
from embodied_depth_trainer.losses.photometric import Patches, photometric_error
from embodied_depth_trainer.losses.visibility import visible

# Automatic exposure changes the gain between neighbouring frames by less than this.
GAIN_LIMITS = (0.5, 2.0)
# Breaks the auto-mask's ties on pixels that are equal in both images.
AUTO_MASK_NOISE = 1e-5


def match_exposure(target: Tensor, warped: Tensor, inside: Tensor) -> Tensor:
    """Applies to `warped` the gain and bias, one pair per image, that bring it closest to `target` in least squares
    over the pixels `inside`. No gradient flows through gain and bias: depth must not profit from a wrong exposure."""
    with torch.no_grad():
        weight = inside.to(warped.dtype)
        count = 3 * weight.sum((1, 2, 3)).clamp(min=1.0)

        def mean(x: Tensor) -> Tensor:
            return ((x * weight).sum((1, 2, 3)) / count).view(-1, 1, 1, 1)

        mean_target = mean(target)
        mean_warped = mean(warped)
        centred = warped - mean_warped
        # An image without contrast does not determine the gain; the small number keeps it at 1.
        tiny = 1e-6
        gain = (mean(centred * (target - mean_target)) + tiny) / (mean(centred * centred) + tiny)
        gain = gain.clamp(*GAIN_LIMITS)
        bias = mean_target - gain * mean_warped
    return gain * warped + bias


def smoothness(disparity: Tensor, image: Tensor) -> Tensor:
    """Edge-aware smoothness: gradients of the mean-normalised disparity, reduced at edges of the image. Scalar."""
    normal = disparity / disparity.mean((2, 3), keepdim=True).clamp(min=1e-7)

    def along(dim: int) -> Tensor:
        step = normal.diff(dim=dim).abs()
        return (step * torch.exp(-image.diff(dim=dim).abs().mean(1, keepdim=True))).mean()

    return along(3) + along(2)


def geometry_inconsistency(projection: Projection, source_depth_m: Tensor) -> Tensor:
    """|z - z'| / (z + z') in 0..1 between a point's depth in the source camera and the depth predicted for the source
    image at that pixel (Bian et al. 2019, SC-SfMLearner)."""
    predicted = projection.sample(source_depth_m)
    computed = projection.depth_m.clamp(min=1e-3)
    return (computed - predicted).abs() / (computed + predicted)


@dataclass(frozen=True)
class LossOptions:
    """The terms of the loss, whose names are part of the checkpoint format. The defaults are for known poses: see the
    trainer's README."""

    smoothness: float = 1e-3
    geometry: float = 0.0
    """Weight of the geometry inconsistency; above 0 it also reduces the weight of occluded pixels."""
    auto_mask: bool = False
    """Ignores pixels that match better without warping (Monodepth2). With known poses, standstill is known, and with
    small baselines the mask removes exactly the pixels that have no other supervision."""
    exposure: bool = True
    """Fits gain and bias of the warped image to the target first."""
    both_ways: bool = False
    """Also warps the target into the sources, and trains their depth (SC-Depth)."""
    visibility: bool = False
    """Ignores points that another point occludes in the source."""
    census: bool = False
    """Compares census transforms instead of colours, for lighting that changes."""


@dataclass(frozen=True)
class View:
    """One source of a target."""

    image: Tensor
    projection: Projection
    depth_m: Tensor | None = None
    """The network's depth of the source, for the geometry inconsistency."""


def self_supervision(
    image: Tensor,
    disparity: Tensor,
    views: Sequence[View],
    options: LossOptions,
    generator: torch.Generator | None = None,
    only: Tensor | None = None,
) -> Tensor:
    """The scalar loss: the sum of `supervision_parts`."""
    return torch.stack(list(supervision_parts(image, disparity, views, options, generator, only).values())).sum()


def supervision_parts(
    image: Tensor,
    disparity: Tensor,
    views: Sequence[View],
    options: LossOptions,
    generator: torch.Generator | None = None,
    only: Tensor | None = None,
) -> dict[str, Tensor]:
    """The weighted parts of the loss, scalars: the photometric error of the best source at every pixel that some source
    sees (limited to `only`, bool [B, 1, H, W]), smoothness, and geometry inconsistency if it has a weight."""
    error_of = _error_to(image, options)
    errors: list[Tensor] = []
    insides: list[Tensor] = []
    geometry = disparity.new_zeros(())
    for view in views:
        warped = view.projection.sample(view.image)
        inside = visible(view.projection) if options.visibility else view.projection.inside
        if options.exposure:
            warped = match_exposure(image, warped, inside)
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
            still = functools.reduce(torch.minimum, [error_of(view.image) for view in views])
            noise = torch.randn(still.shape, generator=generator, dtype=still.dtype).to(still.device)
            counts = counts & (least < still + AUTO_MASK_NOISE * noise)
        # 1 at the best source of every pixel that counts.
        chosen = torch.zeros_like(error).scatter_(1, best, counts.to(error.dtype))
    parts = {
        "photometric": (error * chosen).sum() / processes.mean(counts.sum().float()).clamp(min=1),
        "smoothness": options.smoothness * smoothness(disparity, image),
    }
    return parts if options.geometry == 0 else {**parts, "geometry": options.geometry * geometry}


def _error_to(image: Tensor, options: LossOptions) -> Callable[[Tensor], Tensor]:
    """Returns the function from a warped image to its error [B, 1, H, W]; the target's part is computed once."""
    if options.census:
        signs = census(image)
        return lambda warped: census_error(signs, warped)
    patches = Patches.of(image)
    return lambda warped: photometric_error(patches, warped)


def _mean_where(values: Tensor, mask: Tensor) -> Tensor:
    """Mean over a mask; 0 if it is empty. Values outside of the mask may be infinite."""
    return torch.where(mask, values, 0.0).sum() / processes.mean(mask.sum().float()).clamp(min=1)
