"""The fast loss equals the textbook's loss."""

from __future__ import annotations

import pytest
import torch
from textbook import TextbookLoss
from torch import Tensor

from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.data.projection import Projector
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.losses.photometric import Patches, box3, box3_adjoint, photometric_error
from embodied_depth_trainer.losses.reprojection import LossOptions, View, self_supervision

HEIGHT = 48
WIDTH = 160
CAMERA = Intrinsics(WIDTH, HEIGHT, 80.0, 80.0, 79.5, 23.5)


def poses(dtype: torch.dtype) -> list[Tensor]:
    """Relative poses [2, 4, 4] each: a step sideways and forward, and a step back with a rotation."""
    aside = torch.eye(4, dtype=dtype).repeat(2, 1, 1)
    back = torch.eye(4, dtype=dtype).repeat(2, 1, 1)
    aside[:, 0, 3] = 0.1
    aside[:, 2, 3] = 0.05
    yaw = torch.tensor(0.05, dtype=dtype)
    back[:, 0, 0] = back[:, 2, 2] = yaw.cos()
    back[:, 0, 2] = yaw.sin()
    back[:, 2, 0] = -yaw.sin()
    back[:, 2, 3] = -0.08
    return [aside, back]


def loss_and_gradient(kind: str, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Loss and gradient of two targets with two sources each."""
    image, *sources = (
        torch.cat([random_image((HEIGHT, WIDTH), seed + row) for row in (0, 1)]).to(dtype) for seed in (0, 10, 20)
    )
    depth_m = (1 + 3 * torch.cat([random_image((HEIGHT, WIDTH), 30 + row)[:, :1] for row in (0, 1)])).to(dtype)
    depth_m.requires_grad_()
    projector = Projector(CAMERA)
    projector.k = projector.k.to(dtype)
    projector.rays = projector.rays.to(dtype)
    if kind == "textbook":
        book = TextbookLoss(HEIGHT, WIDTH, projector.k)
        book.warp.pixels = book.warp.pixels.to(dtype)
        loss: Tensor = book(depth_m, image, sources, poses(dtype))
    else:
        pairs = zip(sources, poses(dtype), strict=True)
        views = [View(source, projector(depth_m, pose)) for source, pose in pairs]
        loss = self_supervision(image, 1 / depth_m, views, LossOptions(exposure=False))
    (gradient,) = torch.autograd.grad(loss, depth_m)
    return loss.detach(), gradient


def test_loss_and_gradient_equal_the_textbooks() -> None:
    (ours, gradient), (book, expected) = (loss_and_gradient(kind, torch.float64) for kind in ("ours", "textbook"))
    assert float(ours) == pytest.approx(float(book), rel=1e-7)
    assert float((gradient - expected).abs().max()) < 1e-5 * float(expected.abs().max())


def test_loss_and_gradient_equal_the_textbooks_in_single_precision_up_to_ties() -> None:
    (ours, gradient), (book, expected) = (loss_and_gradient(kind, torch.float32) for kind in ("ours", "textbook"))
    assert float(ours) == pytest.approx(float(book), rel=1e-5)
    # Rounding decides which of two equal sources or neighbouring pixels a point belongs to.
    differs = (gradient - expected).abs() > 1e-4 * expected.abs().max()
    assert float(differs.float().mean()) < 2e-3


def test_means_and_their_adjoint_are_transposes() -> None:
    x = random_image((9, 14), 1).double()
    y = random_image((9, 14), 2).double()
    assert float((box3(x) * y).sum()) == pytest.approx(float((x * box3_adjoint(y)).sum()), rel=1e-12)


def test_the_photometric_errors_gradient_is_the_finite_difference() -> None:
    target = random_image((6, 7), 1).double()
    warped = random_image((6, 7), 2).double().requires_grad_()
    patches = Patches.of(target)
    assert torch.autograd.gradcheck(lambda y: photometric_error(patches, y), warped)


def test_the_projections_gradient_is_the_finite_difference() -> None:
    projector = Projector(Intrinsics(6, 5, 4.0, 4.0, 2.5, 2.0))
    projector.k = projector.k.double()
    projector.rays = projector.rays.double()
    generator = torch.Generator().manual_seed(0)
    depth_m = (2 + torch.rand(2, 1, 5, 6, generator=generator, dtype=torch.float64)).requires_grad_()
    pose = poses(torch.float64)[1]

    def projected(depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        found = projector(depth, pose)
        return found.u, found.v, found.depth_m

    assert torch.autograd.gradcheck(projected, depth_m)
