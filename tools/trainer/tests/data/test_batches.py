"""Each process reads its share of a batch, and gets the samples that one process would have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.data.batches import ColorChanges
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import labels
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer

from ..rooms import room

SETTINGS = Settings(batch=6, crop_width=32)


@pytest.fixture(scope="module")
def walk() -> Frames:
    frames = room(24)
    return replace(frames, labels=labels(frames))


class CountedImages:
    """Images that count how many of them are read."""

    def __init__(self, images: NDArray[np.uint8]) -> None:
        self.images = images
        self.shape = images.shape
        self.read = 0

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: NDArray[np.int64]) -> NDArray[np.uint8]:
        self.read += np.size(index)
        chosen: NDArray[np.uint8] = self.images[index]
        return chosen


def trainer(frames: Frames, settings: Settings) -> Trainer:
    return Trainer(frames, pairs_by_baseline(frames, PairRule()), settings)


@pytest.mark.parametrize("places", [2, 3])
@pytest.mark.parametrize("network", ["student", "manydepth_r18"])
def test_a_share_is_every_nth_sample_of_the_whole_batch(walk: Frames, network: str, places: int) -> None:
    learner = trainer(walk, replace(SETTINGS, network=network))
    for step in range(3):
        whole = learner.part_of_batch(step, slice(None))
        for place in range(places):
            mine = slice(place, None, places)
            share = learner.part_of_batch(step, mine)
            assert share.left == whole.left
            assert np.array_equal(share.targets, whole.targets[mine])
            assert np.array_equal(share.sources, whole.sources[mine])
            for name in ("image", "coarse_full", "labels"):
                assert torch.equal(getattr(share, name), getattr(whole, name)[mine]), name
            # PyTorch may round products of matrices differently in a smaller batch.
            for name in ("augmented", "coarse"):
                assert torch.allclose(getattr(share, name), getattr(whole, name)[mine], rtol=0, atol=1e-5), name
            for image, other in zip(share.source_images, whole.source_images, strict=True):
                assert torch.equal(image, other[mine])


def test_a_process_reads_no_image_of_the_others(walk: Frames) -> None:
    images = CountedImages(walk.rgb)
    learner = trainer(walk, SETTINGS)
    learner.frames = replace(walk, rgb=images)  # type: ignore[arg-type,assignment]
    learner.part_of_batch(0, slice(None))
    everything = images.read
    images.read = 0
    learner.part_of_batch(0, slice(1, None, 3))
    assert 3 * images.read == everything


def test_stronger_changes_of_colours_change_more_images_by_more() -> None:
    usual = ColorChanges.draw(1000, np.random.default_rng(1))
    strong = ColorChanges.draw(1000, np.random.default_rng(1), 0.5)
    shares = [float(np.mean(np.abs(changes.matrix - np.eye(3)).max((1, 2)) > 1e-6)) for changes in (usual, strong)]
    assert shares == pytest.approx([0.5, 0.8], abs=0.05)
    assert np.abs(strong.level).max() > 2 * np.abs(usual.level).max()
