"""Decides which frames are held out: they are never trained on, so that the robot can evaluate a model on them.

The rule is bit-identical to the robot's (`runtime/src/model_gate/held_out.rs`): pose bins of 1 m x 1 m and 45 degrees
of heading in `map` at the exposure, of which an integer hash holds out about a tenth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.pairs import Pairs, alone, while_moving
from embodied_depth_trainer.errors import TrainerError

CELL_M = 1.0
SECTORS = 8
PER_MILLE = 100
SEED = 1
_ALL_BITS = (1 << 64) - 1


def pose_bin(x_m: float, y_m: float, yaw_rad: float) -> tuple[int, int, int]:
    """Cell along x, cell along y, and sector of the heading of `base_link` in `map`."""
    sector = math.floor((yaw_rad / math.tau + 0.5) * SECTORS)
    return math.floor(x_m / CELL_M), math.floor(y_m / CELL_M), sector % SECTORS


def is_held_out(x_m: float, y_m: float, yaw_rad: float, seed: int = SEED) -> bool:
    """Whether a frame taken at this pose is held out."""
    hash_ = seed
    for number in pose_bin(x_m, y_m, yaw_rad):
        hash_ = _mixed(hash_ ^ (number & _ALL_BITS))
    return hash_ % 1000 < PER_MILLE


def _mixed(state: int) -> int:
    """One step of SplitMix64 (Steele, Lea and Flood 2014)."""
    z = (state + 0x9E3779B97F4A7C15) & _ALL_BITS
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _ALL_BITS
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _ALL_BITS
    return z ^ (z >> 31)


def targets_alone(frames: FrameSet, limit: int) -> tuple[Pairs, Pairs]:
    """All frames of a moving camera, without sources: those for training, and at most `limit` of those that are held
    out. Frames that no other is a source of are among them, as those of a rotation on the spot are."""
    held: NDArray[np.bool_] = np.zeros(len(frames), np.bool_) if frames.held_out is None else frames.held_out
    different = while_moving(frames)
    trained = different[~held[different]]
    if not len(trained):
        raise TrainerError(f"all of {len(frames)} frames are held out; let the robot drive through more places")
    return alone(trained), only_held_out(frames, alone(different), limit)


def without_held_out(frames: FrameSet, pairs: Pairs) -> Pairs:
    """The pairs of which neither target nor source is held out."""
    held: NDArray[np.bool_] | None = frames.held_out
    if held is None or not held.any():
        return pairs
    earlier = [sources[~held[sources]] for sources in pairs.earlier]
    later = [sources[~held[sources]] for sources in pairs.later]
    kept = [
        index
        for index, target in enumerate(pairs.targets)
        if not held[target] and (len(earlier[index]) or len(later[index]))
    ]
    if not kept:
        raise TrainerError(
            f"all pairs of {len(frames)} frames include a held-out frame; let the robot drive through more places"
        )
    return Pairs(pairs.targets[kept], [earlier[index] for index in kept], [later[index] for index in kept])


def only_held_out(frames: FrameSet, pairs: Pairs, limit: int) -> Pairs:
    """The pairs whose target is held out, for validation: at most `limit`, evenly spread over all. Empty if no frame is
    held out. Sources may be any frame."""
    held = frames.held_out
    kept = np.flatnonzero(held[pairs.targets]) if held is not None else np.empty(0, np.int64)
    if len(kept) > limit:
        kept = kept[np.linspace(0, len(kept) - 1, limit).round().astype(np.int64)]
    chosen: list[int] = kept.tolist()
    return Pairs(pairs.targets[kept], [pairs.earlier[i] for i in chosen], [pairs.later[i] for i in chosen])
