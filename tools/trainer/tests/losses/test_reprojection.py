"""The losses and the projection against their definitions."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.data.projection import Projector, bilinear_sample, invert_rigid, relative_pose
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.losses.photometric import Patches, photometric_error
from embodied_depth_trainer.losses.reprojection import (
    LossOptions,
    View,
    geometry_inconsistency,
    match_exposure,
    self_supervision,
    smoothness,
)

CAMERA = Intrinsics(24, 16, 12.0, 12.0, 11.5, 7.5)


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Tensor:
    """[1, 4, 4], yaw around the camera's y axis."""
    pose = torch.eye(4)
    angle = torch.tensor(yaw)
    pose[0, 0] = pose[2, 2] = angle.cos()
    pose[0, 2] = angle.sin()
    pose[2, 0] = -angle.sin()
    pose[:3, 3] = torch.tensor([x, y, z])
    return pose[None]


def textbook_error(target: Tensor, warped: Tensor) -> Tensor:
    """The photometric error as the papers define it, one step after another."""

    def mean(x: Tensor) -> Tensor:
        result: Tensor = torch.nn.AvgPool2d(3, 1)(torch.nn.ReflectionPad2d(1)(x))
        return result

    mx = mean(target)
    my = mean(warped)
    sx = mean(target**2) - mx**2
    sy = mean(warped**2) - my**2
    sxy = mean(target * warped) - mx * my
    ssim = (2 * mx * my + 1e-4) * (2 * sxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (sx + sy + 9e-4))
    l1 = (target - warped).abs()
    return (0.85 * torch.clamp((1 - ssim) / 2, 0, 1) + 0.15 * l1).mean(1, keepdim=True)


def textbook_sample(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Bilinear interpolation of four neighbours."""
    height, width = image.shape[-2:]
    left = u.floor().clamp(0, width - 2)
    top = v.floor().clamp(0, height - 2)
    a = (u - left)[:, None]
    b = (v - top)[:, None]
    index = (top * width + left).long().flatten(1)

    def at(offset: int) -> Tensor:
        flat = image.flatten(2)
        return flat.gather(2, (index + offset)[:, None].expand(-1, image.shape[1], -1)).view(
            *image.shape[:2], *u.shape[1:]
        )

    return (1 - b) * ((1 - a) * at(0) + a * at(1)) + b * ((1 - a) * at(width) + a * at(width + 1))


def test_the_photometric_error_and_its_gradient_equal_the_textbooks() -> None:
    # In double precision, because the textbook itself has an error of 3e-5 in single precision.
    target = random_image((16, 24), 1).double()
    warped = random_image((16, 24), 2).double().requires_grad_()
    ours = photometric_error(Patches.of(target), warped)
    (gradient,) = torch.autograd.grad(ours.sum(), warped)
    book = textbook_error(target, warped)
    (expected,) = torch.autograd.grad(book.sum(), warped)
    assert torch.allclose(ours, book, atol=1e-10)
    assert torch.allclose(gradient, expected, atol=1e-10)
    single = photometric_error(Patches.of(target.float()), warped.detach().float())
    assert torch.allclose(single.double(), book, atol=5e-5)


def test_sampling_equals_bilinear_interpolation_of_four_neighbours() -> None:
    generator = torch.Generator().manual_seed(3)
    image = random_image((16, 24), 1)
    u = (torch.rand(1, 16, 24, generator=generator) * 23).requires_grad_()
    v = (torch.rand(1, 16, 24, generator=generator) * 15).requires_grad_()
    ours = bilinear_sample(image, u, v)
    book = textbook_sample(image, u, v)
    assert torch.allclose(ours, book, atol=1e-4)
    weights = random_image((16, 24), 5)
    for found, expected in zip(
        torch.autograd.grad((ours * weights).sum(), (u, v)),
        torch.autograd.grad((book * weights).sum(), (u, v)),
        strict=True,
    ):
        assert torch.allclose(found, expected, atol=1e-4)


def test_an_unmoved_camera_samples_the_same_image() -> None:
    image = random_image((16, 24), 1)
    projection = Projector(CAMERA)(torch.full((1, 1, 16, 24), 2.0), moved())
    assert torch.allclose(projection.sample(image), image, atol=1e-5)
    assert bool(projection.inside.all())


def test_poses_are_source_from_target() -> None:
    # The source is 0.5 m right of the target: the target's points are 0.5 m further left in it.
    relative = relative_pose(moved(x=1.5, z=1.0), moved(x=1.0, z=1.0))
    assert torch.allclose(relative, moved(x=-0.5), atol=1e-6)
    assert torch.allclose(invert_rigid(moved(1, 2, 3, 0.4)) @ moved(1, 2, 3, 0.4), torch.eye(4)[None], atol=1e-6)
    projection = Projector(CAMERA)(torch.full((1, 1, 16, 24), 2.0), relative)
    assert projection.u[0, 0, 12].item() == pytest.approx(12 - 12 * 0.5 / 2, abs=1e-4)
    assert projection.depth_m[0, 0, 8, 8].item() == pytest.approx(2.0)


def test_pixels_outside_and_behind_the_source_do_not_count() -> None:
    projector = Projector(CAMERA)
    depth = torch.full((1, 1, 16, 24), 2.0)
    assert not projector(depth, moved(z=-3.0)).inside.any()
    inside = projector(depth, moved(x=-1.0)).inside[0, 0, 0]
    # 6 px to the left: the first six columns have left the image.
    assert inside.tolist() == [False] * 6 + [True] * 18


def test_a_nan_depth_makes_the_loss_nan_and_reads_no_other_memory() -> None:
    image = random_image((16, 24), 1)
    depth = torch.full((1, 1, 16, 24), 2.0)
    depth[0, 0, 3, 4] = torch.nan
    view = View(image, Projector(CAMERA)(depth, moved(x=0.1)))
    assert not view.projection.inside[0, 0, 3, 4]
    assert self_supervision(image, 1 / depth, [view], LossOptions(smoothness=0.0)).isnan()


def smooth_image(u: Tensor, v: Tensor) -> Tensor:
    """An image that is also defined between pixels, for derivatives without corners."""
    return torch.stack([0.5 + 0.4 * torch.sin(0.5 * u + phase + 0.3 * v) for phase in (0.0, 1.0, 2.0)], 1)


def test_the_losses_gradient_by_depth_is_the_finite_difference() -> None:
    torch.manual_seed(0)
    rows, columns = torch.meshgrid(torch.arange(16.0), torch.arange(24.0), indexing="ij")
    target = smooth_image(columns[None], rows[None]).double()
    source = smooth_image(columns[None] + 1.3, rows[None]).double()
    projector = Projector(CAMERA)
    projector.k = projector.k.double()
    projector.rays = projector.rays.double()
    depth = (2.0 + 0.3 * torch.rand(1, 1, 16, 24, dtype=torch.float64)).requires_grad_()

    def loss(depth_m: Tensor) -> Tensor:
        poses = (moved(x=0.2, z=0.05), moved(x=-0.2, yaw=0.02))
        views = [View(source, projector(depth_m, pose.double())) for pose in poses]
        return self_supervision(target, 1 / depth_m, views, LossOptions(exposure=False, smoothness=0.1))

    (gradient,) = torch.autograd.grad(loss(depth), depth)
    step = 1e-6
    for row, column in [(3, 4), (8, 12), (10, 20)]:
        nudge = torch.zeros_like(depth)
        nudge[0, 0, row, column] = step
        difference = (loss(depth + nudge) - loss(depth - nudge)) / (2 * step)
        assert gradient[0, 0, row, column].item() == pytest.approx(difference.item(), rel=1e-4, abs=1e-7)


def rendered_plane(projector: Projector, depth_m: float, pose: Tensor) -> tuple[Tensor, Tensor]:
    """A textured plane parallel to the target's image, as target and source (translated only) see it."""
    camera = projector.camera
    x, y = (projector.rays[:2] * depth_m).view(2, camera.height, camera.width)
    t = pose[0, :3, 3]
    source_x, source_y = (projector.rays[:2] * (depth_m + float(t[2]))).view(2, camera.height, camera.width)

    def texture(a: Tensor, b: Tensor) -> Tensor:
        waves = [torch.sin(k * a + m * b) for k, m in ((9.0, 2.0), (5.0, 7.0), (13.0, 5.0))]
        return (0.5 + 0.15 * torch.stack(waves)).expand(3, -1, -1)[None]

    return texture(x, y), texture(source_x - t[0], source_y - t[1])


@pytest.mark.parametrize("pose", [moved(x=0.1), moved(z=-0.15), moved(x=-0.07, z=0.1)])
def test_a_rendered_planes_true_depth_minimises_the_loss(pose: Tensor) -> None:
    camera = Intrinsics(96, 64, 48.0, 48.0, 47.5, 31.5)
    projector = Projector(camera)
    target, source = rendered_plane(projector, 2.0, pose)
    depths = torch.linspace(1.8, 2.2, 81)

    def loss(depth_m: float) -> float:
        depth = torch.full((1, 1, 64, 96), depth_m)
        return float(self_supervision(target, 1 / depth, [View(source, projector(depth, pose))], LossOptions()))

    best = depths[torch.tensor([loss(float(depth)) for depth in depths]).argmin()]
    assert abs(float(best) - 2.0) <= 0.5e-2 * 2.0 + 1e-6


def test_exposure_matching_finds_gain_and_bias() -> None:
    target = random_image((16, 24), 1)
    warped = ((target - 0.1) / 1.3).requires_grad_()
    inside = torch.ones(1, 1, 16, 24, dtype=torch.bool)
    inside[..., :5] = False
    damaged = torch.where(inside, warped, 7.0)
    assert torch.allclose(torch.where(inside, match_exposure(target, damaged, inside), target), target, atol=1e-3)
    blank = torch.full_like(target, 0.5)
    assert torch.allclose(match_exposure(blank, blank, inside), blank, atol=1e-5)


def test_smoothness_is_scale_invariant_and_reduced_at_edges() -> None:
    flat = torch.full((1, 3, 8, 8), 0.5)
    step = torch.ones(1, 1, 8, 8)
    step[..., 4:] = 2.0
    edge = flat.clone()
    edge[..., 4:] = 1.0
    assert float(smoothness(step, flat)) == pytest.approx(float(smoothness(7 * step, flat)), rel=1e-5)
    assert float(smoothness(step, edge)) == pytest.approx(float(smoothness(step, flat)) * 2.718281828**-0.5, rel=1e-4)


def test_geometry_is_consistent_for_a_plane_and_not_for_an_occluded_point() -> None:
    projection = Projector(CAMERA)(torch.full((1, 1, 16, 24), 2.0), moved(z=-0.5))
    assert float(geometry_inconsistency(projection, torch.full((1, 1, 16, 24), 1.5)).max()) < 1e-6
    occluded = geometry_inconsistency(projection, torch.full((1, 1, 16, 24), 0.5))
    assert float(occluded.min()) == pytest.approx(0.5, abs=1e-5)


def test_every_pixel_takes_its_best_source_and_unseen_pixels_take_none() -> None:
    image = random_image((16, 24), 1)
    other = random_image((16, 24), 2)
    projector = Projector(CAMERA)
    depth = torch.full((1, 1, 16, 24), 2.0)
    plain = LossOptions(exposure=False, smoothness=0.0)
    good = View(image, projector(depth, moved()))
    bad = View(other, projector(depth, moved()))
    assert float(self_supervision(image, 1 / depth, [bad, good], plain)) == pytest.approx(0.0, abs=1e-5)
    behind = View(image, projector(depth, moved(z=-3.0)))
    alone = self_supervision(image, 1 / depth, [behind], plain)
    assert float(alone) == 0.0
    with_bad = self_supervision(image, 1 / depth, [behind, bad], plain)
    assert float(with_bad) == pytest.approx(float(textbook_error(image, other).mean()), abs=1e-4)


def test_the_auto_mask_ignores_pixels_that_match_better_unwarped() -> None:
    image = random_image((16, 24), 1)
    depth = torch.full((1, 1, 16, 24), 2.0, requires_grad=True)
    view = View(image, Projector(CAMERA)(depth, moved(x=0.3)))
    masked = LossOptions(auto_mask=True, smoothness=0.0)
    assert float(self_supervision(image, 1 / depth, [view], masked).detach()) < 0.01
    assert float(self_supervision(image, 1 / depth, [view], LossOptions(smoothness=0.0)).detach()) > 0.03


def test_the_border_is_padded_by_reflection() -> None:
    row = torch.arange(6.0).view(1, 1, 1, 6).expand(1, 3, 6, 6)
    assert torch.allclose(Patches.of(row).mean[0, 0, 0, :2], torch.tensor([2 / 3, 1.0]))
    assert F.mse_loss(Patches.of(row).variance[..., 1:-1], torch.full((1, 3, 6, 4), 2 / 3)) < 1e-10
