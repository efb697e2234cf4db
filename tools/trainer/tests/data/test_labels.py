"""Labels that are computed from a whole recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import CELL, agreed, labels
from embodied_depth_trainer.errors import TrainerError

from ..rooms import room


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(60, (64, 192))


def ratio(found: NDArray[np.uint16], frames: Frames) -> NDArray[np.float64]:
    """Ratio of labelled depth to the truth, 0 where labelled is no label."""
    assert frames.truth_mm is not None
    share: NDArray[np.float64] = found[:, 0] / frames.truth_mm[:, CELL // 2 :: CELL, CELL // 2 :: CELL]
    return share


def test_votes_of_other_frames_fill_the_holes_of_a_frame(walk: Frames) -> None:
    assert walk.coarse is not None
    hole = walk.coarse[:, 0, CELL // 2 :: CELL, CELL // 2 :: CELL] == 0
    found = ratio(labels(walk), walk)
    labelled = found > 0
    assert labelled[hole].mean() > 0.3
    assert np.abs(np.log(found[hole & labelled])).mean() < 0.05


def test_a_single_frame_is_labelled_with_its_own_confident_depth_only(walk: Frames) -> None:
    alone = replace(walk, run=np.arange(len(walk), dtype=np.int32))
    assert walk.coarse is not None
    own = walk.coarse[:, 0, CELL // 2 :: CELL, CELL // 2 :: CELL]
    found = labels(alone)
    assert np.array_equal(found[:, 0] > 0, own > 0)
    assert np.abs(found[:, 0].astype(int) - own).max() <= 1


def test_frames_of_different_runs_do_not_vote_for_each_other(walk: Frames) -> None:
    moved = walk.t_world_camera.copy()
    moved[1::2, :3, 3] += 0.5
    two = replace(walk, t_world_camera=moved, run=np.arange(len(walk), dtype=np.int32) % 2)
    found = ratio(labels(two), two)
    assert np.abs(np.log(found[found > 0])).mean() < 0.05


def vote(*depths_m: float) -> tuple[float, float]:
    """Depth and share of agreement of one cell from votes of weight 1."""
    logs = np.log(np.array(depths_m))
    mean, share = agreed(np.zeros(len(logs), np.int64), logs, np.ones(len(logs)), 1)
    return float(np.exp(mean[0])), float(share[0])


def test_the_near_surface_occludes_the_far_one_unless_it_has_few_votes() -> None:
    assert vote(1.0, 1.02, 0.98, 1.0, 4.0, 4.1, 3.9, 4.0, 4.0)[0] == pytest.approx(1.0, rel=0.02)
    assert vote(1.0, 4.0, 4.1, 3.9, 4.0, 4.0)[0] == pytest.approx(4.0, rel=0.02)


def test_confidence_of_a_label_grows_with_the_number_of_agreeing_votes() -> None:
    assert vote(2.0)[1] < vote(2.0, 2.0)[1] < vote(2.0, 2.0, 2.0, 2.0)[1]
    assert vote(2.0, 2.0, 2.0, 2.0, 7.0)[1] < vote(2.0, 2.0, 2.0, 2.0)[1]


def test_labels_without_coarse_depth_are_refused(walk: Frames) -> None:
    with pytest.raises(TrainerError, match="coarse depth"):
        labels(replace(walk, coarse=None))
