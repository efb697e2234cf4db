"""Depth labels that are computed from a whole recording, without a depth sensor.

The robot's coarse depth of a frame uses earlier frames only. A recording also holds later frames and frames from other
places. The confident coarse depth of many frames, projected into one of them, votes on the depth of its cells. A cell
gets a label where enough votes agree, also where the frame has no coarse depth itself: in a hole, or after a rotation
on the spot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.data.pairs import PairRule, grid_rays, overlap
from embodied_depth_trainer.errors import TrainerError

# Side of a label's cell in pixels, which is that of the robot's coarse depth.
CELL = 4
# Votes come from every `EVERY`th frame up to this gap (the pose drifts), up to this baseline and from this overlap on.
EVERY = 8
MAX_GAP = 120
MAX_BASELINE_M = 1.0
MIN_OVERLAP = 0.2
# Least confidence of coarse depth that may vote. The frame's own coarse depth counts several times, since nothing can
# occlude it.
MIN_CONFIDENCE = 0.7
OWN_VOTES = 4.0
# Votes in a bin of this width of ln depth and in its two neighbours agree: within 15 % of the middle.
BIN = 0.1
NEAREST_M = 0.3
FARTHEST_M = 20.0
BINS = int(np.ceil(np.log(FARTHEST_M / NEAREST_M) / BIN)) + 2
# The nearest depth with this share of the strongest depth's votes occludes what is behind it.
OCCLUDING_SHARE = 0.6
# Weight of votes against each label before any is counted: two confident votes alone make no label.
PRIOR_AGAINST = 1.0
MIN_LABEL = 0.45


@dataclass(frozen=True)
class _Points:
    """The confident cells of one frame."""

    in_world: NDArray[np.float64]
    """[P, 3]."""
    confidence: NDArray[np.float64]
    """[P]."""


def labels(
    frames: FrameSet, targets: NDArray[np.int64] | None = None, voters: NDArray[np.int64] | None = None
) -> NDArray[np.uint16]:
    """[T, 2, H / CELL, W / CELL]: z-depth in millimetres (0: none) and confidence times 65535 of each cell's middle,
    for the frames at `targets` (all, if it is not given). The frames at `voters` vote, by default every `EVERY`th."""
    if frames.coarse is None:
        raise TrainerError("labels are computed from coarse depth; prepare the recordings with it")
    chosen = np.arange(len(frames)) if targets is None else targets
    voting = np.arange(0, len(frames), EVERY) if voters is None else voters
    if not len(chosen):
        return np.empty((0, 2, frames.camera.height // CELL, frames.camera.width // CELL), np.uint16)
    near = voting[(voting >= chosen.min() - MAX_GAP) & (voting <= chosen.max() + MAX_GAP)]
    rays = _cell_rays(frames.camera)
    points = {index: _points(frames, index, rays, MIN_CONFIDENCE) for index in near.tolist()}
    return np.stack([_label(frames, target, points, rays) for target in chosen.tolist()])


def _cell_rays(camera: Intrinsics) -> NDArray[np.float64]:
    """Points at z = 1 m on the ray of the middle pixel of each cell, [cells, 3]."""
    middle = CELL // 2
    u, v = np.meshgrid(np.arange(middle, camera.width, CELL), np.arange(middle, camera.height, CELL))
    x = (u.ravel() - camera.cx) / camera.fx
    y = (v.ravel() - camera.cy) / camera.fy
    return np.stack([x, y, np.ones(x.size)], axis=1)


def _points(frames: FrameSet, index: int, rays: NDArray[np.float64], least: float) -> _Points:
    depth_m, confidence = _cells(frames, index)
    chosen = (depth_m > 0) & (confidence >= least)
    pose = frames.t_world_camera[index]
    in_camera = rays[chosen] * depth_m[chosen, None]
    return _Points(in_camera @ pose[:3, :3].T + pose[:3, 3], confidence[chosen])


def _cells(frames: FrameSet, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth in metres and confidence of the cells of one frame, [cells] each."""
    assert frames.coarse is not None
    middle = CELL // 2
    depth, confidence = frames.coarse[index][:, middle::CELL, middle::CELL].reshape(2, -1).astype(np.float64)
    return depth / 1000, confidence / 65535


def _voters(frames: FrameSet, target: int, places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the frames at `places` that overlap with the target."""
    poses = frames.t_world_camera
    near: NDArray[np.int64] = places[(np.abs(places - target) <= MAX_GAP) & (places != target)]
    near = near[frames.run[near] == frames.run[target]]
    near = near[np.linalg.norm(poses[near, :3, 3] - poses[target, :3, 3], axis=1) <= MAX_BASELINE_M]
    if not len(near):
        return near
    assumed = grid_rays(frames.camera) * PairRule.assumed_depth_m
    chosen: NDArray[np.int64] = near[overlap(poses[near], poses[target], frames.camera, assumed) >= MIN_OVERLAP]
    return chosen


def _label(frames: FrameSet, target: int, points: dict[int, _Points], rays: NDArray[np.float64]) -> NDArray[np.uint16]:
    camera = frames.camera
    rows = camera.height // CELL
    columns = camera.width // CELL
    cells, logs, weights = _votes(
        frames, target, [points[int(i)] for i in _voters(frames, target, np.array(list(points)))]
    )
    depth_m, confidence = _cells(frames, target)
    own = np.flatnonzero(depth_m > 0)
    cells = np.concatenate([cells, own])
    logs = np.concatenate([logs, np.log(depth_m[own])])
    weights = np.concatenate([weights, OWN_VOTES * confidence[own]])
    ln_depth, share = agreed(cells, logs, weights, rows * columns)
    labelled = share >= MIN_LABEL
    millimetres = np.where(labelled, np.exp(ln_depth) * 1000, 0).round()
    planes: NDArray[np.float64] = np.stack([millimetres, np.where(labelled, share, 0) * 65535]).round()
    return planes.reshape(2, rows, columns).astype(np.uint16)


def _votes(
    frames: FrameSet, target: int, voters: list[_Points]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Cell, ln z-depth and weight of each point that projects into the target's image."""
    if not voters:
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    camera = frames.camera
    pose = frames.t_world_camera[target]
    points = (np.concatenate([voter.in_world for voter in voters]) - pose[:3, 3]) @ pose[:3, :3]
    weights = np.concatenate([voter.confidence for voter in voters])
    z = points[:, 2]
    in_front = z > NEAREST_M
    points = points[in_front]
    z = z[in_front]
    weights = weights[in_front]
    column = np.floor((camera.fx * points[:, 0] / z + camera.cx + 0.5) / CELL).astype(np.int64)
    row = np.floor((camera.fy * points[:, 1] / z + camera.cy + 0.5) / CELL).astype(np.int64)
    columns = camera.width // CELL
    rows = camera.height // CELL
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return (row * columns + column)[inside], np.log(z[inside]), weights[inside]


def agreed(
    cells: NDArray[np.int64], logs: NDArray[np.float64], weights: NDArray[np.float64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """ln depth that most votes of each of `count` cells agree on, and the share of the votes that agree."""
    place = ((logs - np.log(NEAREST_M)) / BIN).astype(np.int64).clip(0, BINS - 1)
    votes = np.bincount(cells * BINS + place, weights, count * BINS).reshape(count, BINS)
    padded = np.pad(votes, ((0, 0), (1, 1)))
    window = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    strongest = window.max(axis=1, keepdims=True)
    # The first window that is strong enough, then the best bin among that and the next two.
    first = (window >= np.maximum(OCCLUDING_SHARE * strongest, 1e-9)).argmax(axis=1)
    ahead = np.minimum(first[:, None] + np.arange(3), BINS - 1)
    best = np.take_along_axis(ahead, np.take_along_axis(window, ahead, 1).argmax(axis=1)[:, None], 1)[:, 0]
    agrees = np.abs(place - best[cells]) <= 1
    weight = np.bincount(cells[agrees], weights[agrees], count)
    total = np.bincount(cells, weights, count)
    mean = np.bincount(cells[agrees], (weights * logs)[agrees], count) / np.maximum(weight, 1e-9)
    return mean, weight / (total + PRIOR_AGAINST)
