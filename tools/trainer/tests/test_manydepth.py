"""The cost volume is the robot's, and ManyDepth takes it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.frames import Frames
from embodied_depth_trainer.manydepth import PLANES, Disturbance, ManyDepth, consistency, untrustworthy
from embodied_depth_trainer.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.training import Settings, Trainer
from embodied_depth_trainer.volume import plane_depths, references, volume_planes

from .rooms import camera, room

DEPTHS_M = plane_depths(24, (0.5, 10.0))


def wall(depth_m: float, places_m: list[float], gains: list[float]) -> Frames:
    """A wall across the optical axis, seen from places beside each other."""
    view = camera(96, 160)
    u, v = np.meshgrid(np.arange(view.width), np.arange(view.height))

    def picture(x_m: float, gain: float) -> NDArray[np.uint8]:
        x, y = (u - view.cx) / view.fx + x_m / depth_m, (v - view.cy) / view.fy
        colours = [gain * (100 + 50 * np.sin(f * x) + 40 * np.cos(f * 1.3 * y)) for f in (7.0, 9.0, 11.0)]
        painted: NDArray[np.uint8] = np.stack(colours, -1).round().clip(0, 255).astype(np.uint8)
        return painted

    poses = np.tile(np.eye(4), (len(places_m), 1, 1))
    poses[:, 0, 3] = places_m
    pictures = np.stack([picture(x_m, gain) for x_m, gain in zip(places_m, gains, strict=True)])
    count = len(places_m)
    return Frames(view, pictures, poses, np.arange(count, dtype=np.int64), np.zeros(count, np.int32))


@pytest.mark.parametrize(("plane", "gain"), [(3, 1.0), (6, 1.0), (11, 1.0), (6, 1.15)])
def test_the_cost_of_a_wall_is_least_on_the_plane_that_it_stands_on(plane: int, gain: float) -> None:
    frames = wall(float(DEPTHS_M[plane]), [-0.15, 0.0], [gain, 1.0])
    volume = volume_planes(frames, np.array([1]), DEPTHS_M)[0]
    # The left edge was in view before, the right one not.
    winners = volume.argmin(0)[1:-1, :28]
    assert float(((winners - plane).abs() <= 1).float().mean()) >= 0.95


def test_without_an_earlier_picture_or_a_baseline_there_is_no_evidence() -> None:
    frames = wall(2.0, [0.0, 0.01, 5.0], [1.0] * 3)
    assert float(volume_planes(frames, np.array([0, 1, 2]), DEPTHS_M).abs().max()) == 0.0


def test_cells_that_were_never_in_view_take_the_largest_cost_of_their_pixel() -> None:
    volume = volume_planes(wall(2.0, [-0.2, 0.0], [1.0, 1.0]), np.array([1]), DEPTHS_M)[0]
    near_edge = volume[:, 12, 36]
    assert float(near_edge[-1]) == float(near_edge.max()) > float(near_edge.min())
    assert float(volume[:, 12, 39].abs().max()) == 0.0


def test_references_are_earlier_pictures_of_the_same_run_near_15_cm() -> None:
    frames = wall(2.0, [0.0, 0.05, 0.10, 0.16, 0.20, 0.30], [1.0] * 6)
    assert references(frames, np.array([0, 1, 5])).tolist() == [[-1, -1], [0, -1], [3, 2]]
    frames.run[:4] = 7
    assert references(frames, np.array([5])).tolist() == [[4, -1]]


def test_still_pictures_and_moving_poses_make_a_far_wall() -> None:
    frames = wall(2.0, [-0.15, 0.0], [1.0, 1.0])
    still = volume_planes(frames, np.array([1]), DEPTHS_M, still=np.array([True]))[0]
    # Nothing has moved in the picture, so the plane of least parallax fits best.
    assert float((still.argmin(0)[1:-1, :28] == 0).float().mean()) > 0.95


def test_the_teacher_is_asked_where_matching_and_it_disagree_by_more_than_two() -> None:
    volume = torch.ones(1, 24, 2, 2)
    volume[0, 6] = 0.0
    volume[0, :, 1, 1] = 0.0
    at = float(DEPTHS_M[6])
    teacher = torch.full((1, 1, 8, 8), 1.9 * at)
    teacher[..., :4, 4:] = 2.1 * at
    taught = untrustworthy(volume, DEPTHS_M, teacher)[0, 0]
    assert taught[:4, 4:].all()
    assert taught[4:, 4:].all()
    assert not taught[:, :4].any()
    depth = 1.2 * teacher
    assert float(consistency(depth, teacher, taught[None, None])) == pytest.approx(0.2 * 0.5, rel=1e-4)


def test_half_of_the_samples_are_disturbed() -> None:
    drawn = Disturbance.draw(4000, np.random.default_rng(0))
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
