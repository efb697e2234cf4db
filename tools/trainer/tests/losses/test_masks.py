"""Census, visibility and geometry consistency."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.data.projection import Projector
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.losses.census import census, census_error
from embodied_depth_trainer.losses.reprojection import LossOptions, View, geometry_inconsistency, self_supervision
from embodied_depth_trainer.losses.visibility import visible

PROJECTOR = Projector(Intrinsics(24, 16, 12.0, 12.0, 11.5, 7.5))


def aside(x_m: float) -> Tensor:
    pose = torch.eye(4)[None]
    pose[0, 0, 3] = x_m
    return pose


def test_census_ignores_gain_and_bias_but_not_structure() -> None:
    image = random_image((16, 24), 1)
    other = random_image((16, 24), 2)
    signs = census(image)
    assert float(census_error(signs, image).max()) == 0.0
    assert float(census_error(signs, 0.8 * image + 0.1).mean()) < 0.1 * float(census_error(signs, other).mean())


def test_the_census_losss_gradient_is_the_finite_difference() -> None:
    signs = census(random_image((5, 6), 1).double())
    warped = random_image((5, 6), 2).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda y: census_error(signs, y), warped)


def test_with_census_the_loss_is_the_census_error() -> None:
    image = random_image((16, 24), 1)
    other = random_image((16, 24), 2)
    depth_m = torch.full((1, 1, 16, 24), 2.0)
    view = View(other, PROJECTOR(depth_m, aside(0.0)))
    loss = self_supervision(image, 1 / depth_m, [view], LossOptions(exposure=False, smoothness=0.0, census=True))
    assert float(loss) == pytest.approx(float(census_error(census(image), other).mean()), rel=1e-3)


def test_a_post_occludes_the_wall_behind_it_in_a_shifted_view() -> None:
    depth_m = torch.full((1, 1, 16, 24), 3.0)
    depth_m[..., 10:13] = 1.0
    assert bool(visible(PROJECTOR(depth_m, aside(0.0))).all())
    # Seen from 0.5 m to the side, the post moves by 6 pixels and the wall by 2: the post covers the wall 4 columns
    # further on.
    unoccluded = visible(PROJECTOR(depth_m, aside(0.5)))[0, 0, 8]
    assert unoccluded[10:13].all()
    assert not unoccluded[14:17].any()
    assert unoccluded[:10].all()
    assert unoccluded[17:20].all()


def test_only_selected_pixels_count() -> None:
    image = random_image((16, 24), 1)
    other = random_image((16, 24), 2)
    depth_m = torch.full((1, 1, 16, 24), 2.0)
    only = torch.zeros(1, 1, 16, 24, dtype=torch.bool)
    half = torch.where(torch.arange(24) < 12, image, other)
    only[..., :9] = True
    view = View(half, PROJECTOR(depth_m, aside(0.0)))
    plain = LossOptions(exposure=False, smoothness=0.0)
    assert float(self_supervision(image, 1 / depth_m, [view], plain, only=only)) == pytest.approx(0.0, abs=1e-5)
    assert float(self_supervision(image, 1 / depth_m, [view], plain)) > 0.05


def test_geometry_consistency_has_a_gradient_for_the_source_depth() -> None:
    projection = PROJECTOR(torch.full((1, 1, 16, 24), 2.0), aside(0.1))
    predicted = torch.full((1, 1, 16, 24), 2.5, requires_grad=True)
    (gradient,) = torch.autograd.grad(geometry_inconsistency(projection, predicted).sum(), predicted)
    # |2 - d| / (2 + d) grows with d > 2.
    assert float(gradient[..., 3:-3].min()) == pytest.approx(4 / 4.5**2, rel=1e-4)
