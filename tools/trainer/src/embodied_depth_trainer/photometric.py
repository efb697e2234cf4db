"""How unlike two pictures are, pixel by pixel: 0.85 (1 - SSIM) / 2 + 0.15 L1 over 3x3 pixels (Godard et al. 2019).

Half of a training step used to pass here. What makes it fast changes no number: means of 3x3 pixels are six additions
of whole planes; what belongs to the target is computed once for all its sources; and the gradient with respect to the
warped picture is written down instead of being found operator by operator.

With x the target and y the warped picture, E the mean of 3x3 pixels, m = E[y], q = E[y y], p = E[x y]:

    a1 = 2 E[x] m + C1            b1 = E[x]^2 + m^2 + C1            SSIM = a1 a2 / (b1 b2)
    a2 = 2 (p - E[x] m) + C2      b2 = E[x x] - E[x]^2 + q - m^2 + C2
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

# Weight of SSIM beside L1, and its constants for pictures in 0..1.
ALPHA = 0.85
C1, C2 = 0.01**2, 0.03**2


def box3(x: Tensor) -> Tensor:
    """Mean of 3x3 pixels, the border reflected. No gradient flows through."""
    return _sum3(_sum3(x, 2, 0), 3, 0).div_(9)


def box3_adjoint(x: Tensor) -> Tensor:
    """The transpose of `box3`: where a gradient with respect to the means comes from."""
    return _sum3(_sum3(x, 3, 1), 2, 1).div_(9)


def _sum3(x: Tensor, dim: int, reflected_into: int) -> Tensor:
    """Each pixel with its two neighbours along `dim`. At the border the inner neighbour counts twice for the outermost
    pixel (0: a reflected border), or the outermost twice for the inner (1: its transpose)."""
    size = x.shape[dim]
    total = torch.empty_like(x)
    torch.add(x.narrow(dim, 0, size - 1), x.narrow(dim, 1, size - 1), out=total.narrow(dim, 0, size - 1))
    total.narrow(dim, size - 1, 1).copy_(x.narrow(dim, size - 1, 1))
    total.narrow(dim, 1, size - 1).add_(x.narrow(dim, 0, size - 1))
    for border, inner in ((0, 1), (size - 1, size - 2)):
        to, come_from = (border, inner) if reflected_into == 0 else (inner, border)
        total.narrow(dim, to, 1).add_(x.narrow(dim, come_from, 1))
    return total


@dataclass(frozen=True)
class Patches:
    """A target with its 3x3 means, which are the same for all sources."""

    picture: Tensor
    mean: Tensor
    variance: Tensor

    @staticmethod
    def of(picture: Tensor) -> Patches:
        mean = box3(picture)
        return Patches(picture, mean, box3(picture * picture).addcmul_(mean, mean, value=-1))


def photometric_error(target: Patches, warped: Tensor) -> Tensor:
    """Of [B, 3, H, W] in 0..1 the mean over colours [B, 1, H, W]; differentiable by `warped`."""
    error: Tensor = _PhotometricError.apply(warped, target.picture, target.mean, target.variance)
    return error


class _PhotometricError(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, y: Tensor, x: Tensor, mean: Tensor, variance: Tensor) -> Tensor:  # noqa: ANN401
        m, q, p = box3(y), box3(y * y), box3(x * y)
        a1 = (mean * m).mul_(2).add_(C1)
        a2 = p.addcmul_(mean, m, value=-1).mul_(2).add_(C2)
        b1 = (mean * mean).addcmul_(m, m).add_(C1)
        b2 = q.addcmul_(m, m, value=-1).add_(variance).add_(C2)
        over = (b1 * b2).reciprocal_()
        # In -1..1 by the Cauchy-Schwarz inequality: the papers' clamp only cuts rounding.
        ssim = (a1 * a2).mul_(over)
        difference = y - x
        error = difference.abs().mul_(1 - ALPHA).add_(0.5 * ALPHA).sub_(ssim, alpha=0.5 * ALPHA).mean(1, keepdim=True)
        if ctx.needs_input_grad[0]:
            # Derivatives of SSIM by m, q and p.
            by_m = (a2 - a1).mul_(mean).sub_((b2 - b1).mul_(ssim).mul_(m)).mul_(over).mul_(2)
            by_q = ssim.mul_(b1).mul_(over).neg_()
            by_p = a1.mul_(over).mul_(2)
            ctx.save_for_backward(by_m, by_q, by_p, x, y, difference)
        return error

    @staticmethod
    def backward(ctx: Any, by_error: Tensor) -> tuple[Tensor, None, None, None]:  # noqa: ANN401
        *by_means, x, y, difference = ctx.saved_tensors
        colours = x.shape[1]
        by_ssim = by_error * (-0.5 * ALPHA / colours)
        by_m, by_q, by_p = (box3_adjoint(by_mean * by_ssim) for by_mean in by_means)
        by_y = by_m.addcmul_(by_q, y, value=2).addcmul_(by_p, x)
        return by_y.addcmul_(difference.sign(), by_error, value=(1 - ALPHA) / colours), None, None, None
