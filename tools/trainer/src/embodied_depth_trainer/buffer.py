"""Which pictures are kept to learn from when there are more than the buffer holds."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .errors import TrainerError
from .frames import Frames
from .pairs import Pairs

Keep = Literal["newest", "poses"]

# A pose's bin: half a metre, and about 30 degrees of the direction of view (2 sin 15 degrees of a unit vector).
BIN_M = 0.5
BIN_DIRECTION = 0.52


def kept(frames: Frames, pairs: Pairs, size: int, keep: Keep, seed: int) -> Pairs:
    """At most `size` targets: the `newest`, as the paper's queue keeps them, or as equally many as possible at random
    from every bin of `poses`, so that what was seen long ago and seldom is not forgotten."""
    if size < 1:
        raise TrainerError(f"a buffer of {size} pictures holds nothing; give 1 or more")
    if len(pairs) <= size:
        return pairs
    if keep == "newest":
        chosen: NDArray[np.int64] = np.arange(len(pairs) - size, len(pairs))
    else:
        chosen = _spread(pose_bins(frames)[pairs.targets], size, np.random.default_rng(seed))
    return Pairs(pairs.targets[chosen], [pairs.earlier[i] for i in chosen], [pairs.later[i] for i in chosen])


def pose_bins(frames: Frames) -> NDArray[np.int64]:
    """The bin of every frame [N]."""
    place = np.floor(frames.t_world_camera[:, :3, 3] / BIN_M)
    direction = np.round(frames.t_world_camera[:, :3, 2] / BIN_DIRECTION)
    _, bins = np.unique(np.column_stack([frames.run, place, direction]), axis=0, return_inverse=True)
    return bins.reshape(-1).astype(np.int64)


def _spread(bins: NDArray[np.int64], size: int, random: np.random.Generator) -> NDArray[np.int64]:
    """Indices of `size` of the members, taking one from each bin in turn."""
    shuffled = random.permutation(len(bins))
    # How many of its bin came before it.
    turn = np.empty(len(bins), np.int64)
    for one in np.unique(bins):
        members = shuffled[bins[shuffled] == one]
        turn[members] = np.arange(len(members))
    order = shuffled[np.argsort(turn[shuffled], kind="stable")]
    chosen: NDArray[np.int64] = np.sort(order[:size])
    return chosen
