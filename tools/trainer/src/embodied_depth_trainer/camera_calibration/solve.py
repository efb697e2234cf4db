"""Least squares over intrinsics and poses of all views (Levenberg-Marquardt).

A view's pose has no part in another view's residuals. So the poses are eliminated from the normal equations view by
view (Schur complement), and the remaining system has only the intrinsics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats
from embodied_depth_trainer.camera_calibration.camera import Camera
from embodied_depth_trainer.camera_calibration.poses import Poses, cross_matrices
from embodied_depth_trainer.camera_calibration.views import Observations

STEPS = 100
# A step that lowers the cost by less than this share ends the search.
LEAST_GAIN = 1e-9
# Above this damping no step lowers the cost.
MOST_DAMPING = 1e10


@dataclass(frozen=True)
class Solution:
    """A camera, the poses of the views, and what remains."""

    camera: Camera
    poses: Poses
    residuals: Floats
    """Seen minus projected pixels [n, 2]."""
    information: Floats
    """Normal matrix of the intrinsics after elimination of the poses [p, p]. Times the variance of a pixel coordinate,
    its inverse is their covariance."""

    @property
    def rms_px(self) -> float:
        """Root mean square length of a residual."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))


@dataclass(frozen=True)
class _Normal:
    """Normal equations at one point."""

    intrinsics: Floats
    """[p, p]"""
    mixed: Floats
    """[v, p, 6]"""
    poses: Floats
    """[v, 6, 6]"""
    to_intrinsics: Floats
    """Right-hand side [p]."""
    to_poses: Floats
    """Right-hand side [v, 6]."""

    def eliminated(self, damping: float) -> tuple[Floats, Floats, Floats, Floats]:
        """The system of the intrinsics alone, its right-hand side, and what gives the poses' step from theirs."""
        poses = self.poses + damping * _diagonals(self.poses) + 1e-12 * np.eye(6)
        solved = np.linalg.solve(poses, np.concatenate([self.mixed.transpose(0, 2, 1), self.to_poses[:, :, None]], 2))
        by_intrinsics = solved[:, :, :-1]
        alone = solved[:, :, -1]
        system = self.intrinsics + damping * np.diag(np.diag(self.intrinsics))
        system = system - np.einsum("vpi,viq->pq", self.mixed, by_intrinsics)
        right = self.to_intrinsics - np.einsum("vpi,vi->p", self.mixed, alone)
        return system, right, by_intrinsics, alone


def _diagonals(matrices: Floats) -> Floats:
    diagonals: Floats = matrices * np.eye(matrices.shape[-1])
    return diagonals


def project(camera: Camera, poses: Poses, seen: Observations) -> Floats:
    return camera.project(_in_camera(poses, seen))


def _in_camera(poses: Poses, seen: Observations) -> Floats:
    rotated = np.einsum("nij,nj->ni", poses.rotation[seen.view], seen.points_mm)
    points: Floats = rotated + poses.translation_mm[seen.view]
    return points


def _normal(camera: Camera, poses: Poses, seen: Observations, weights: Floats, free: Flags) -> _Normal:
    points = _in_camera(poses, seen)
    pixels, by_values, by_points = camera.project_with_derivatives(points)
    # A small rotation w on the camera's side moves R X by w x R X.
    by_rotation = -by_points @ cross_matrices(points - poses.translation_mm[seen.view])
    error = seen.pixels - pixels
    row = np.concatenate([by_values[:, :, free], by_rotation, by_points, error[:, :, None]], axis=2)
    products = _by_view((weights[:, None, None] * row.transpose(0, 2, 1)) @ row, seen)
    ours = slice(0, int(free.sum()))
    pose = slice(ours.stop, ours.stop + 6)
    return _Normal(
        products[:, ours, ours].sum(axis=0),
        products[:, ours, pose],
        products[:, pose, pose],
        products[:, ours, -1].sum(axis=0),
        products[:, pose, -1],
    )


def _by_view(values: Floats, seen: Observations) -> Floats:
    """Sums over the corners of each view; a view without corners has zeros."""
    found = np.zeros((seen.views, *values.shape[1:]))
    present, starts = np.unique(seen.view, return_index=True)
    found[present] = np.add.reduceat(values, starts, axis=0)
    return found


def solve(
    camera: Camera,
    poses: Poses,
    seen: Observations,
    weights: Floats | None = None,
    free: Flags | None = None,
    steps: int = STEPS,
) -> Solution:
    """The least squares from a start. `free` marks the intrinsics that may change; none of them solves for poses."""
    used = np.ones(len(seen.view)) if weights is None else weights
    changing = np.ones(len(camera.values), np.bool_) if free is None else free
    damping = 1e-4
    cost = _cost(camera, poses, seen, used)
    normal = _normal(camera, poses, seen, used, changing)
    for _ in range(steps):
        moved = _step(camera, poses, normal, damping, changing)
        lower = _cost(*moved, seen, used) if moved is not None else np.inf
        if moved is None or not lower <= cost:
            damping *= 8.0
            if damping > MOST_DAMPING:
                break
            continue
        gain = cost - lower
        camera, poses = moved
        normal = _normal(camera, poses, seen, used, changing)
        damping = max(damping / 8.0, 1e-12)
        cost, before = lower, cost
        if gain <= LEAST_GAIN * before:
            break
    return Solution(camera, poses, seen.pixels - project(camera, poses, seen), normal.eliminated(0.0)[0])


def _cost(camera: Camera, poses: Poses, seen: Observations, weights: Floats) -> float:
    """Weighted sum of squares; infinite where a corner is behind the camera."""
    with np.errstate(all="ignore"):
        error = seen.pixels - project(camera, poses, seen)
        total = float(np.sum(weights * np.sum(error**2, axis=1)))
    return total if np.isfinite(total) else np.inf


def _step(camera: Camera, poses: Poses, normal: _Normal, damping: float, free: Flags) -> tuple[Camera, Poses] | None:
    """The camera and the poses after one step, or None where the equations have no solution."""
    try:
        system, right, by_intrinsics, alone = normal.eliminated(damping)
        intrinsics = np.linalg.solve(system, right)
    except np.linalg.LinAlgError:
        return None
    values = camera.values.copy()
    values[free] += intrinsics
    step = alone - by_intrinsics @ intrinsics
    if not (np.isfinite(values).all() and np.isfinite(step).all() and (values[:2] > 0).all()):
        return None
    return camera.with_values(values), poses.moved(step)
