"""Census, visibility and the learning of both ways."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from embodied_depth_trainer.census import census, census_error
from embodied_depth_trainer.frames import Intrinsics
from embodied_depth_trainer.losses import LossOptions, View, geometry_inconsistency, self_supervision
from embodied_depth_trainer.onnx_file import random_picture
from embodied_depth_trainer.visibility import visible
from embodied_depth_trainer.warp import Projector

PROJECTOR = Projector(Intrinsics(24, 16, 12.0, 12.0, 11.5, 7.5))


def aside(x_m: float) -> Tensor:
    pose = torch.eye(4)[None]
    pose[0, 0, 3] = x_m
    return pose


def test_census_forgives_gain_and_bias_and_no_other_structure() -> None:
    picture, other = random_picture((16, 24), 1), random_picture((16, 24), 2)
    signs = census(picture)
    assert float(census_error(signs, picture).max()) == 0.0
    assert float(census_error(signs, 0.8 * picture + 0.1).mean()) < 0.1 * float(census_error(signs, other).mean())


def test_the_census_losss_gradient_is_the_finite_difference() -> None:
    signs = census(random_picture((5, 6), 1).double())
    warped = random_picture((5, 6), 2).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda y: census_error(signs, y), warped)


def test_with_census_the_loss_is_the_census_error() -> None:
    picture, other = random_picture((16, 24), 1), random_picture((16, 24), 2)
    depth_m = torch.full((1, 1, 16, 24), 2.0)
    view = View(other, PROJECTOR(depth_m, aside(0.0)))
    loss = self_supervision(picture, 1 / depth_m, [view], LossOptions(exposure=False, smoothness=0.0, census=True))
    assert float(loss) == pytest.approx(float(census_error(census(picture), other).mean()), rel=1e-3)


def test_a_post_hides_the_wall_behind_it_from_the_side_and_nothing_from_where_it_is_seen() -> None:
    depth_m = torch.full((1, 1, 16, 24), 3.0)
    depth_m[..., 10:13] = 1.0
    assert bool(visible(PROJECTOR(depth_m, aside(0.0))).all())
    # 0.5 m aside, the post moves by 6 pixels and the wall by 2: the post now covers 4 columns further on.
    seen = visible(PROJECTOR(depth_m, aside(0.5)))[0, 0, 8]
    assert seen[10:13].all()
    assert not seen[14:17].any()
    assert seen[:10].all()
    assert seen[17:20].all()


def test_only_the_asked_pixels_count() -> None:
    picture, other = random_picture((16, 24), 1), random_picture((16, 24), 2)
    depth_m, only = torch.full((1, 1, 16, 24), 2.0), torch.zeros(1, 1, 16, 24, dtype=torch.bool)
    half = torch.where(torch.arange(24) < 12, picture, other)
    only[..., :9] = True
    view, plain = View(half, PROJECTOR(depth_m, aside(0.0))), LossOptions(exposure=False, smoothness=0.0)
    assert float(self_supervision(picture, 1 / depth_m, [view], plain, only=only)) == pytest.approx(0.0, abs=1e-5)
    assert float(self_supervision(picture, 1 / depth_m, [view], plain)) > 0.05


def test_the_sources_depth_learns_from_the_geometry() -> None:
    projection = PROJECTOR(torch.full((1, 1, 16, 24), 2.0), aside(0.1))
    said = torch.full((1, 1, 16, 24), 2.5, requires_grad=True)
    (gradient,) = torch.autograd.grad(geometry_inconsistency(projection, said).sum(), said)
    # |2 - d| / (2 + d) grows with d > 2.
    assert float(gradient[..., 3:-3].min()) == pytest.approx(4 / 4.5**2, rel=1e-4)
