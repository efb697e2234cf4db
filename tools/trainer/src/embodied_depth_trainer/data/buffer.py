"""Limits the training to a buffer of frames, by age or by pose."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.pairs import Pairs
from embodied_depth_trainer.errors import TrainerError

Keep = Literal["newest", "poses"]

# Size of a pose bin: half a metre, and about 30 degrees of the viewing direction (2 sin 15 degrees of a unit vector).
BIN_M = 0.5
BIN_DIRECTION = 0.52


def select(frames: FrameSet, pairs: Pairs, size: int, keep: Keep, seed: int) -> Pairs:
    """Keeps at most `size` targets: the `newest`, as the paper's queue does, or equally many at random from every bin
    of `poses`, so that places seen long ago or rarely are not forgotten."""
    if size < 1:
        raise TrainerError(f"a buffer of {size} frames is empty; give 1 or more")
    if len(pairs) <= size:
        return pairs
    if keep == "newest":
        chosen: NDArray[np.int64] = np.arange(len(pairs) - size, len(pairs))
    else:
        chosen = _spread(pose_bins(frames)[pairs.targets], size, np.random.default_rng(seed))
    return Pairs(pairs.targets[chosen], [pairs.earlier[i] for i in chosen], [pairs.later[i] for i in chosen])


def pose_bins(frames: FrameSet) -> NDArray[np.int64]:
    """Index of the pose bin of every frame [N]."""
    place = np.floor(frames.t_world_camera[:, :3, 3] / BIN_M)
    direction = np.round(frames.t_world_camera[:, :3, 2] / BIN_DIRECTION)
    _, bins = np.unique(np.column_stack([frames.run, place, direction]), axis=0, return_inverse=True)
    return bins.reshape(-1).astype(np.int64)


def _spread(bins: NDArray[np.int64], size: int, random: np.random.Generator) -> NDArray[np.int64]:
    """Selects `size` members round-robin: one of each bin, then a second of each, and so on; returns their indices."""
    shuffled = random.permutation(len(bins))
    # Rank of every member within its bin.
    rank = np.empty(len(bins), np.int64)
    for one in np.unique(bins):
        members = shuffled[bins[shuffled] == one]
        rank[members] = np.arange(len(members))
    order = shuffled[np.argsort(rank[shuffled], kind="stable")]
    chosen: NDArray[np.int64] = np.sort(order[:size])
    return chosen
