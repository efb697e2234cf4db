"""Chooses the source frames of every target frame by the known poses.

Depth is observable only under translation: a pair without baseline teaches nothing, and one without overlap teaches
noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.errors import TrainerError

# Gap of the sources in frames, in simulation and on the real robot (Embodied Depth Prediction, Liu et al.).
PAPER_GAP_SIMULATED = 4
PAPER_GAP_REAL = 15
# Size of the pixel grid on which overlap is estimated.
GRID_ROWS = 6
GRID_COLUMNS = 12
# A camera that moves less than this from one frame to another stands.
STANDS_M = 0.01
STANDS_RAD = 0.01


@dataclass(frozen=True)
class PairRule:
    """The conditions under which a frame is a source of another."""

    min_baseline_m: float = 0.05
    max_baseline_m: float = 0.30
    min_overlap: float = 0.6
    """Share of the target's pixels that the source sees too if everything is `assumed_depth_m` away."""
    assumed_depth_m: float = 2.5
    max_gap: int = 120
    """In frames; limited because the pose drifts with time."""

    def __post_init__(self) -> None:
        if not 0 < self.min_baseline_m < self.max_baseline_m:
            raise TrainerError(
                f"baselines from {self.min_baseline_m} to {self.max_baseline_m} m are an empty range; "
                "give 0 < MIN_M < MAX_M"
            )


@dataclass(frozen=True)
class Pairs:
    """Target frames and the source frames of each."""

    targets: NDArray[np.int64]
    earlier: Sequence[NDArray[np.int64]]
    """For each target, the sources before it."""
    later: Sequence[NDArray[np.int64]]
    """For each target, the sources after it."""

    def __len__(self) -> int:
        return len(self.targets)

    @cached_property
    def have_sources(self) -> bool:
        return any(len(side) for sides in (self.earlier, self.later) for side in sides)

    def sample(self, batch: int, generator: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Draws `batch` targets [B] and two sources of each [B, 2]: one before and one after where both exist, because
        each sees parts of the scene that the other does not. Targets that are `alone` have none [B, 0]."""
        chosen = generator.integers(len(self.targets), size=batch)
        if not self.have_sources:
            return self.targets[chosen], np.empty((batch, 0), np.int64)
        sources = np.empty((batch, 2), np.int64)
        for row, index in enumerate(chosen):
            sides = [side for side in (self.earlier[index], self.later[index]) if len(side)]
            sources[row] = generator.choice(sides[0]), generator.choice(sides[-1])
        return self.targets[chosen], sources


def while_moving(frames: FrameSet) -> NDArray[np.int64]:
    """The frames in which the camera has moved: a robot at its place for an hour shows one view 36,000 times."""
    poses = frames.t_world_camera
    kept: list[int] = []
    for index in range(len(frames)):
        if not kept or frames.run[kept[-1]] != frames.run[index] or _has_moved(poses[kept[-1]], poses[index]):
            kept.append(index)
    return np.array(kept, np.int64)


def _has_moved(before: NDArray[np.float64], now: NDArray[np.float64]) -> bool:
    if np.linalg.norm(now[:3, 3] - before[:3, 3]) >= STANDS_M:
        return True
    cosine = (np.sum(before[:3, :3] * now[:3, :3]) - 1) / 2
    return bool(cosine <= math.cos(STANDS_RAD))


def alone(targets: NDArray[np.int64]) -> Pairs:
    """Targets without sources, for a loss that compares depth with labels only."""
    nothing = [np.empty(0, np.int64)] * len(targets)
    return Pairs(targets, nothing, nothing)


def pairs_by_baseline(frames: FrameSet, rule: PairRule) -> Pairs:
    """All pairs whose baseline and overlap satisfy the rule. Standing still and rotating on the spot give none."""
    whole = range(len(frames))
    found = [sources_of(frames, target, whole, rule) for target in whole]
    return _pairs(found, "move more, or allow shorter baselines")


def sources_of(frames: FrameSet, target: int, among: range, rule: PairRule) -> NDArray[np.int64]:
    """The sources of a frame among consecutive frames, in their order."""
    poses = frames.t_world_camera
    first = max(among.start, target - rule.max_gap)
    end = min(among.stop, target + rule.max_gap + 1)
    window: NDArray[np.int64] = np.arange(first, end)
    window = window[frames.run[window] == frames.run[target]]
    baseline = np.linalg.norm(poses[window, :3, 3] - poses[target, :3, 3], axis=1)
    window = window[(baseline >= rule.min_baseline_m) & (baseline <= rule.max_baseline_m)]
    if not len(window):
        return window
    points = grid_rays(frames.camera) * rule.assumed_depth_m
    window = window[overlap(poses[window], poses[target], frames.camera, points) >= rule.min_overlap]
    return window


def pairs_by_gap(frames: FrameSet, gap: int) -> Pairs:
    """The paper's pairs: the frames `gap` before and after, at any distance. Only pairs without motion (less than 1
    mm), whose depth has no gradient, are left out."""
    position = frames.t_world_camera[:, :3, 3]

    def sources(target: int) -> NDArray[np.int64]:
        both: NDArray[np.int64] = np.array([target - gap, target + gap], np.int64)
        both = both[(both >= 0) & (both < len(frames))]
        moved = np.linalg.norm(position[both] - position[target], axis=1) > 1e-3
        both = both[moved & (frames.run[both] == frames.run[target])]
        return both

    return _pairs([sources(target) for target in range(len(frames))], "give another gap")


def overlap(
    t_world_sources: NDArray[np.float64],
    t_world_target: NDArray[np.float64],
    camera: Intrinsics,
    points: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Share of the target's `points` [P, 3] that lie within each source's image, [S]."""
    in_world = points @ t_world_target[:3, :3].T + t_world_target[:3, 3]
    # R^T (x - t), for all sources at once.
    local = np.einsum("sji,spj->spi", t_world_sources[:, :3, :3], in_world[None] - t_world_sources[:, None, :3, 3])
    z = local[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = camera.fx * local[..., 0] / z + camera.cx
        v = camera.fy * local[..., 1] / z + camera.cy
    inside = (z > 0) & (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)
    share: NDArray[np.float64] = inside.mean(axis=1)
    return share


def grid_rays(camera: Intrinsics) -> NDArray[np.float64]:
    """Points at z = 1 m on the ray through the middle of each grid cell, [P, 3]."""
    u = (np.arange(GRID_COLUMNS) + 0.5) * camera.width / GRID_COLUMNS - 0.5
    v = (np.arange(GRID_ROWS) + 0.5) * camera.height / GRID_ROWS - 0.5
    x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)


def _pairs(sources: Sequence[NDArray[np.int64]], advice: str) -> Pairs:
    """The pairs of all frames that have a source."""
    targets = np.array([target for target, found in enumerate(sources) if len(found)], np.int64)
    if not len(targets):
        raise TrainerError(f"none of {len(sources)} frames has a source with enough baseline and overlap; {advice}")
    return by_side(targets, [sources[target] for target in targets])


def by_side(targets: NDArray[np.int64], sources: Sequence[NDArray[np.int64]]) -> Pairs:
    """The pairs of these targets with their sources, which are divided into earlier and later ones."""
    both = list(zip(targets.tolist(), sources, strict=True))
    return Pairs(targets, [found[found < at] for at, found in both], [found[found > at] for at, found in both])
