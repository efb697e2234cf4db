"""The cost volume equals the robot's, and ManyDepth uses it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.networks.cost_volume import plane_depths, references, volume_planes
from embodied_depth_trainer.networks.manydepth import PLANES, ManyDepth, VolumeAugmentation, teacher_error, unreliable
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer

from ..rooms import camera, room

DEPTHS_M = plane_depths(24, (0.5, 10.0))


def wall(depth_m: float, places_m: list[float], gains: list[float]) -> Frames:
    """A wall across the optical axis, seen from positions beside each other."""
    view = camera(96, 160)
    u, v = np.meshgrid(np.arange(view.width), np.arange(view.height))

    def image(x_m: float, gain: float) -> NDArray[np.uint8]:
        x = (u - view.cx) / view.fx + x_m / depth_m
        y = (v - view.cy) / view.fy
        colours = [gain * (100 + 50 * np.sin(f * x) + 40 * np.cos(f * 1.3 * y)) for f in (7.0, 9.0, 11.0)]
        painted: NDArray[np.uint8] = np.stack(colours, -1).round().clip(0, 255).astype(np.uint8)
        return painted

    poses = np.tile(np.eye(4), (len(places_m), 1, 1))
    poses[:, 0, 3] = places_m
    images = np.stack([image(x_m, gain) for x_m, gain in zip(places_m, gains, strict=True)])
    count = len(places_m)
    return Frames(view, images, poses, np.arange(count, dtype=np.int64), np.zeros(count, np.int32))


@pytest.mark.parametrize(("plane", "gain"), [(3, 1.0), (6, 1.0), (11, 1.0), (6, 1.15)])
def test_the_cost_of_a_wall_is_least_on_the_plane_that_it_stands_on(plane: int, gain: float) -> None:
    frames = wall(float(DEPTHS_M[plane]), [-0.15, 0.0], [gain, 1.0])
    volume = volume_planes(frames, np.array([1]), DEPTHS_M)[0]
    # The left edge was in view before, the right one was not.
    winners = volume.argmin(0)[1:-1, :28]
    assert float(((winners - plane).abs() <= 1).float().mean()) >= 0.95


def test_the_volume_is_zero_without_an_earlier_frame_or_baseline() -> None:
    frames = wall(2.0, [0.0, 0.01, 5.0], [1.0] * 3)
    assert float(volume_planes(frames, np.array([0, 1, 2]), DEPTHS_M).abs().max()) == 0.0


def test_cells_that_were_never_in_view_take_the_largest_cost_of_their_pixel() -> None:
    volume = volume_planes(wall(2.0, [-0.2, 0.0], [1.0, 1.0]), np.array([1]), DEPTHS_M)[0]
    near_edge = volume[:, 12, 36]
    assert float(near_edge[-1]) == float(near_edge.max()) > float(near_edge.min())
    assert float(volume[:, 12, 39].abs().max()) == 0.0


def test_references_are_earlier_frames_of_the_same_run_near_15_cm() -> None:
    frames = wall(2.0, [0.0, 0.05, 0.10, 0.16, 0.20, 0.30], [1.0] * 6)
    assert references(frames, np.array([0, 1, 5])).tolist() == [[-1, -1], [0, -1], [3, 2]]
    frames.run[:4] = 7
    assert references(frames, np.array([5])).tolist() == [[4, -1]]


def test_static_images_with_moving_poses_look_like_a_far_wall() -> None:
    frames = wall(2.0, [-0.15, 0.0], [1.0, 1.0])
    still = volume_planes(frames, np.array([1]), DEPTHS_M, still=np.array([True]))[0]
    # Nothing moved in the images, so the plane of least parallax matches best.
    assert float((still.argmin(0)[1:-1, :28] == 0).float().mean()) > 0.95


def test_the_teacher_supervises_where_it_differs_from_matching_by_a_factor_of_two() -> None:
    volume = torch.ones(1, 24, 2, 2)
    volume[0, 6] = 0.0
    volume[0, :, 1, 1] = 0.0
    at = float(DEPTHS_M[6])
    teacher = torch.full((1, 1, 8, 8), 1.9 * at)
    teacher[..., :4, 4:] = 2.1 * at
    taught = unreliable(volume, DEPTHS_M, teacher)[0, 0]
    assert taught[:4, 4:].all()
    assert taught[4:, 4:].all()
    assert not taught[:, :4].any()
    depth = 1.2 * teacher
    assert float(teacher_error(depth, teacher, taught[None, None])) == pytest.approx(0.2 * 0.5, rel=1e-4)


def test_half_of_the_volumes_are_made_uninformative() -> None:
    drawn = VolumeAugmentation.draw(4000, np.random.default_rng(0))
    assert drawn.still is not None
    assert drawn.empty is not None
    assert drawn.still.mean() == pytest.approx(0.25, abs=0.03)
    assert drawn.empty.mean() == pytest.approx(0.25, abs=0.03)
    assert not (drawn.still & drawn.empty).any()


def test_the_teacher_learns_until_it_is_frozen() -> None:
    frames = room(24)
    settings = Settings(network="manydepth_r18", batch=2, learning_rate=1e-3, teacher_steps=1)
    learner = Trainer(frames, pairs_by_baseline(frames, PairRule()), settings)
    assert isinstance(learner.network, ManyDepth)
    weights = [learner.network.teacher.decoder.head.weight.detach().clone()]
    for _ in range(2):
        learner.advance()
        weights.append(learner.network.teacher.decoder.head.weight.detach().clone())
    assert not torch.equal(weights[0], weights[1])
    assert torch.equal(weights[1], weights[2])
    assert learner.batch(0).coarse.shape == (2, PLANES, 8, 24)
