"""Training learns what is there, from pictures and poses alone: worlds with known depth, without any coarse depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.evaluation import evaluate, predict
from embodied_depth_trainer.frames import Frames
from embodied_depth_trainer.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.training import Settings, Trainer

from .rooms import camera, room

PHOTOMETRIC = Settings(learning_rate=2e-3, coarse_weight=0.0)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def without_coarse(frames: Frames) -> Frames:
    return replace(frames, coarse=np.zeros((len(frames), 2, *frames.rgb.shape[1:3]), np.uint16))


def wall(depth_m: float, count: int = 40) -> Frames:
    """A textured wall across the optical axis, seen from places beside each other."""
    view, random = camera(32, 96), np.random.default_rng(0)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = random.uniform(-0.4, 0.4, count), random.uniform(-0.2, 0.2, count)
    u, v = np.meshgrid(np.arange(view.width), np.arange(view.height))

    def picture(pose: NDArray[np.float64]) -> NDArray[np.uint8]:
        x, y = (u - view.cx) / view.fx * depth_m + pose[0, 3], (v - view.cy) / view.fy * depth_m + pose[1, 3]
        waves = [
            sum((np.sin(k * x + m * y + c) for k, m in ((9, 2), (5, 7), (13, 5), (3, -4))), np.zeros(x.shape))
            for c in range(3)
        ]
        return (127 + 20 * np.stack(waves, -1)).clip(0, 255).astype(np.uint8)

    pictures = np.stack([picture(pose) for pose in poses])
    return without_coarse(Frames(view, pictures, poses, np.arange(count, dtype=np.int64), np.zeros(count, np.int32)))


def trained(frames: Frames, steps: int, settings: Settings = PHOTOMETRIC) -> Trainer:
    trainer = Trainer(frames, pairs_by_baseline(frames, PairRule()), settings)
    for _ in range(steps):
        trainer.advance()
    return trainer


@pytest.mark.parametrize("depth_m", [1.5, 4.0])
def test_a_rendered_plane_is_learnt_to_within_2_percent(depth_m: float) -> None:
    frames = wall(depth_m)
    trainer = trained(frames, 200, replace(PHOTOMETRIC, augment=False))
    found, _ = predict(trainer.network, frames, np.arange(8), PHOTOMETRIC.depth_range_m)
    assert float(np.median(np.abs(found / depth_m - 1))) < 0.02


def test_one_tiny_room_is_learnt_better_than_a_constant_by_a_tenth() -> None:
    unseen = without_coarse(room(40, seed=9))
    trainer = trained(without_coarse(room(300)), 200)
    rows = evaluate(unseen, {"student": trainer.network}, PHOTOMETRIC.depth_range_m)
    assert rows["student"].delta1 > rows["constant"].delta1 + 0.1
    # Poses are in metres, so the depth is as well.
    assert rows["student"].delta1_unscaled > rows["constant"].delta1 + 0.05
