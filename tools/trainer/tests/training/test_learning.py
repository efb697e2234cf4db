"""Training learns known depth from images and poses alone, without any coarse depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.studies.evaluation import evaluate, predict
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer

from ..rooms import camera, room

PHOTOMETRIC = Settings(learning_rate=2e-3, coarse_weight=0.0)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def without_coarse(frames: Frames) -> Frames:
    return replace(frames, coarse=np.zeros((len(frames), 2, *frames.rgb.shape[1:3]), np.uint16))


def wall(depth_m: float, count: int = 40) -> Frames:
    """A textured wall across the optical axis, seen from positions beside each other."""
    view = camera(32, 96)
    random = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = random.uniform(-0.4, 0.4, count)
    poses[:, 1, 3] = random.uniform(-0.2, 0.2, count)
    u, v = np.meshgrid(np.arange(view.width), np.arange(view.height))

    def image(pose: NDArray[np.float64]) -> NDArray[np.uint8]:
        x = (u - view.cx) / view.fx * depth_m + pose[0, 3]
        y = (v - view.cy) / view.fy * depth_m + pose[1, 3]
        waves = [
            sum((np.sin(k * x + m * y + c) for k, m in ((9, 2), (5, 7), (13, 5), (3, -4))), np.zeros(x.shape))
            for c in range(3)
        ]
        return (127 + 20 * np.stack(waves, -1)).clip(0, 255).astype(np.uint8)

    images = np.stack([image(pose) for pose in poses])
    return without_coarse(Frames(view, images, poses, np.arange(count, dtype=np.int64), np.zeros(count, np.int32)))


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


def test_training_in_one_small_room_beats_a_constant_by_a_tenth() -> None:
    unseen = without_coarse(room(40, seed=9))
    trainer = trained(without_coarse(room(300)), 200)
    rows = evaluate(unseen, {"student": trainer.network}, PHOTOMETRIC.depth_range_m)
    assert rows["student"].delta1 > rows["constant"].delta1 + 0.1
    # Poses are in metres, so depth is metric as well.
    assert rows["student"].delta1_unscaled > rows["constant"].delta1 + 0.05
