"""The fast loss is the textbook's loss."""

from __future__ import annotations

import pytest
import torch
from textbook import TextbookLoss
from torch import Tensor

from embodied_depth_trainer.frames import Intrinsics
from embodied_depth_trainer.losses import LossOptions, View, self_supervision
from embodied_depth_trainer.onnx_file import random_picture
from embodied_depth_trainer.photometric import Patches, box3, box3_adjoint, photometric_error
from embodied_depth_trainer.warp import Projector

HEIGHT, WIDTH = 48, 160
CAMERA = Intrinsics(WIDTH, HEIGHT, 80.0, 80.0, 79.5, 23.5)


def poses(dtype: torch.dtype) -> list[Tensor]:
    """[2, 4, 4] each: a step aside and forward, and one back with a turn."""
    aside, back = torch.eye(4, dtype=dtype).repeat(2, 1, 1), torch.eye(4, dtype=dtype).repeat(2, 1, 1)
    aside[:, 0, 3], aside[:, 2, 3] = 0.1, 0.05
    turn = torch.tensor(0.05, dtype=dtype)
    back[:, 0, 0] = back[:, 2, 2] = turn.cos()
    back[:, 0, 2], back[:, 2, 0], back[:, 2, 3] = turn.sin(), -turn.sin(), -0.08
    return [aside, back]


def loss_and_gradient(kind: str, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Of two targets with two sources each."""
    picture, *sources = (
        torch.cat([random_picture((HEIGHT, WIDTH), seed + row) for row in (0, 1)]).to(dtype) for seed in (0, 10, 20)
    )
    depth_m = (1 + 3 * torch.cat([random_picture((HEIGHT, WIDTH), 30 + row)[:, :1] for row in (0, 1)])).to(dtype)
    depth_m.requires_grad_()
    projector = Projector(CAMERA)
    projector.k, projector.rays = projector.k.to(dtype), projector.rays.to(dtype)
    if kind == "textbook":
        book = TextbookLoss(HEIGHT, WIDTH, projector.k)
        book.warp.pixels = book.warp.pixels.to(dtype)
        loss: Tensor = book(depth_m, picture, sources, poses(dtype))
    else:
        seen = zip(sources, poses(dtype), strict=True)
        views = [View(source, projector(depth_m, pose)) for source, pose in seen]
        loss = self_supervision(picture, 1 / depth_m, views, LossOptions(exposure=False))
    (gradient,) = torch.autograd.grad(loss, depth_m)
    return loss.detach(), gradient


def test_loss_and_gradient_are_the_textbooks() -> None:
    (ours, gradient), (book, expected) = (loss_and_gradient(kind, torch.float64) for kind in ("ours", "textbook"))
    assert float(ours) == pytest.approx(float(book), rel=1e-7)
    assert float((gradient - expected).abs().max()) < 1e-5 * float(expected.abs().max())


def test_in_single_precision_as_well_up_to_ties() -> None:
    (ours, gradient), (book, expected) = (loss_and_gradient(kind, torch.float32) for kind in ("ours", "textbook"))
    assert float(ours) == pytest.approx(float(book), rel=1e-5)
    # Rounding decides which of two equal sources or neighbouring pixels a point belongs to.
    differs = (gradient - expected).abs() > 1e-4 * expected.abs().max()
    assert float(differs.float().mean()) < 2e-3


def test_means_and_their_adjoint_are_transposes() -> None:
    x, y = random_picture((9, 14), 1).double(), random_picture((9, 14), 2).double()
    assert float((box3(x) * y).sum()) == pytest.approx(float((x * box3_adjoint(y)).sum()), rel=1e-12)


def test_the_photometric_errors_gradient_is_the_finite_difference() -> None:
    target, warped = random_picture((6, 7), 1).double(), random_picture((6, 7), 2).double().requires_grad_()
    patches = Patches.of(target)
    assert torch.autograd.gradcheck(lambda y: photometric_error(patches, y), warped)


def test_the_projections_gradient_is_the_finite_difference() -> None:
    projector = Projector(Intrinsics(6, 5, 4.0, 4.0, 2.5, 2.0))
    projector.k, projector.rays = projector.k.double(), projector.rays.double()
    generator = torch.Generator().manual_seed(0)
    depth_m = (2 + torch.rand(2, 1, 5, 6, generator=generator, dtype=torch.float64)).requires_grad_()
    pose = poses(torch.float64)[1]

    def projected(depth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        found = projector(depth, pose)
        return found.u, found.v, found.depth_m

    assert torch.autograd.gradcheck(projected, depth_m)
