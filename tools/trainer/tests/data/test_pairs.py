"""Pairs of target and source frames are chosen by known poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from embodied_depth_trainer.data.dataset import find_pairs
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline, pairs_by_gap
from embodied_depth_trainer.errors import TrainerError

from ..rooms import room


def frames_at(positions: list[float], yaws: list[float] | None = None) -> Frames:
    """Frames along x, with the given headings."""
    frames = room(len(positions))
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, 0, 3] = positions
    for pose, yaw in zip(poses, yaws or [0.0] * len(positions), strict=True):
        pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    return replace(frames, t_world_camera=poses)


def sources(frames: Frames) -> dict[int, list[int]]:
    pairs = pairs_by_baseline(frames, PairRule())
    both = zip(pairs.earlier, pairs.later, strict=True)
    return {
        int(t): sorted([*map(int, early), *map(int, late)])
        for t, (early, late) in zip(pairs.targets, both, strict=True)
    }


def test_baselines_within_the_rule_are_pairs_and_others_are_not() -> None:
    assert sources(frames_at([0.0, 0.03, 0.1, 0.6, 1.2])) == {0: [2], 1: [2], 2: [0, 1]}


def test_standing_still_and_rotating_on_the_spot_give_no_pairs() -> None:
    with pytest.raises(TrainerError, match="none of 4 frames has a source"):
        sources(frames_at([0.0] * 4, [0.0, 0.1, 0.2, 0.3]))


def test_a_loss_that_needs_no_sources_is_trained_on_rotations_too() -> None:
    # The third frame shows what the second does.
    yaws = [0.0, 0.1, 0.1, 0.2, 0.3]
    frames = replace(frames_at([0.0] * 5, yaws), held_out=np.array([False, True, True, False, False]))
    pairs, held = find_pairs(frames, None, PairRule(), needs_sources=False)
    assert (pairs.targets.tolist(), held.targets.tolist()) == ([0, 3, 4], [1])
    targets, sources_of_targets = pairs.sample(8, np.random.default_rng(1))
    assert set(targets.tolist()) <= {0, 3, 4}
    assert sources_of_targets.shape == (8, 0)
    with pytest.raises(TrainerError, match="all of 5 frames are held out"):
        find_pairs(replace(frames, held_out=np.ones(5, np.bool_)), None, PairRule(), needs_sources=False)


def test_a_frame_that_looks_elsewhere_is_not_a_source() -> None:
    assert sources(frames_at([0.0, 0.1, 0.2], [0.0, 1.2, 0.1])) == {0: [2], 2: [0]}


def test_frames_of_different_runs_are_not_paired() -> None:
    frames = replace(frames_at([0.0, 0.1, 0.2, 0.3]), run=np.array([0, 0, 1, 1], np.int32))
    assert sources(frames) == {0: [1], 1: [0], 2: [3], 3: [2]}
    assert pairs_by_gap(frames, 1).targets.tolist() == [0, 1, 2, 3]
    with pytest.raises(TrainerError, match="another gap"):
        pairs_by_gap(frames, 2)


def test_the_papers_gap_accepts_any_baseline_above_zero() -> None:
    pairs = pairs_by_gap(frames_at([0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 5.0, 6.0, 7.0]), 4)
    assert [int(target) for target in pairs.targets] == [1, 2, 3, 4, 5, 6, 7, 8]
    # Frames 0 and 4 are at the same place.
    assert list(pairs.earlier[3]) == []


def test_samples_follow_from_the_seed_and_have_a_source_on_each_side() -> None:
    pairs = pairs_by_baseline(frames_at(list(np.arange(12) * 0.05)), PairRule())

    def sample(seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return pairs.sample(64, np.random.default_rng(seed))

    (targets, chosen) = sample(1)
    (again, chosen_again) = sample(1)
    assert np.array_equal(targets, again)
    assert np.array_equal(chosen, chosen_again)
    assert not np.array_equal(chosen, sample(2)[1])
    inner = (targets > 0) & (targets < 11)
    assert (chosen[inner, 0] < targets[inner]).all()
    assert (chosen[inner, 1] > targets[inner]).all()


def test_an_empty_rule_is_refused() -> None:
    with pytest.raises(TrainerError, match="0 < MIN_M < MAX_M"):
        PairRule(min_baseline_m=0.3, max_baseline_m=0.1)
