"""How far a projection may be off: from the noise of the corners, and from calibrations that lack some views.

Both are maps over the image of the root mean square distance, in pixels, between where a thing at infinity appears and
where the calibration says. Calibrations may differ by a rotation of the camera that nothing can notice, because the
robot's mount takes it up; the rotation that explains most is therefore taken out of every difference first, as mrcal
does (its "projection uncertainty" and "cross-validation").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats, Indices
from embodied_depth_trainer.camera_calibration.camera import Camera
from embodied_depth_trainer.camera_calibration.fit import Fit
from embodied_depth_trainer.camera_calibration.poses import cross_matrices, rotations
from embodied_depth_trainer.camera_calibration.solve import solve
from embodied_depth_trainer.camera_calibration.views import Observations

# Points of a map along the longer side of the image.
MAP_POINTS = 40
# Groups of views, each of which is left out once.
GROUPS = 10
# Gauss-Newton steps for the rotation between two calibrations; the differences are small.
ROTATION_STEPS = 5


@dataclass(frozen=True)
class Grid:
    """Pixels that are evenly spread over the image."""

    pixels: Floats
    """[n, 2]"""
    shape: tuple[int, int]

    def image(self, values: Floats) -> Floats:
        return values.reshape(self.shape)


def grid(camera: Camera) -> Grid:
    step = max(camera.width, camera.height) / MAP_POINTS
    rows = max(2, round(camera.height / step))
    columns = max(2, round(camera.width / step))
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, columns), np.linspace(0, camera.height - 1, rows))
    return Grid(np.column_stack([x.ravel(), y.ravel()]), (rows, columns))


def projected(fit: Fit) -> Floats:
    """The map that follows from the covariance of the intrinsics [rows, columns]; NaN where the model is not valid."""
    camera = fit.solution.camera
    points = grid(camera)
    rays, valid = camera.rays(points.pixels)
    _, by_values, by_rays = camera.project_with_derivatives(rays)
    by_rotation = -by_rays @ cross_matrices(rays)
    # The rotation that explains most of a change of the intrinsics is a linear function of it.
    columns = by_rotation[valid].reshape(-1, 3)
    rotation = np.linalg.lstsq(columns, by_values[valid].reshape(len(columns), -1), rcond=None)[0]
    left = by_values - by_rotation @ rotation
    variance = np.einsum("nki,ij,nkj->n", left, fit.covariance, left)
    return points.image(np.where(valid, np.sqrt(np.maximum(variance, 0.0)), np.nan))


@dataclass(frozen=True)
class CrossValidation:
    """Calibrations that each lack a group of views."""

    cameras: list[Camera]
    held_out_px: float
    """Root mean square residual of corners in views that the calibration did not have; only their poses were fitted."""

    def differences(self, camera: Camera) -> Floats:
        """The map of differences, scaled so that it estimates the same error as `projected` [rows, columns]: the
        jackknife with groups, in which the calibrations differ by far less than independent ones would."""
        points = grid(camera)
        rays, valid = camera.rays(points.pixels)
        shifts = np.stack([_difference(other, camera, rays, valid) for other in self.cameras])
        groups = len(self.cameras)
        variance = (groups - 1) / groups * np.sum((shifts - shifts.mean(axis=0)) ** 2, axis=(0, 2))
        return points.image(np.where(valid, np.sqrt(variance), np.nan))


def _difference(other: Camera, camera: Camera, rays: Floats, valid: Flags) -> Floats:
    """Pixels [n, 2] by which the other camera projects rays elsewhere, after the best rotation is taken out."""
    pixels = camera.project(rays)
    rotated = rays
    for _ in range(ROTATION_STEPS):
        with np.errstate(all="ignore"):
            found, _, by_rays = other.project_with_derivatives(rotated)
        usable = valid & np.isfinite(found).all(axis=1)
        by_rotation = -by_rays[usable] @ cross_matrices(rotated[usable])
        step = np.linalg.lstsq(by_rotation.reshape(-1, 3), (pixels - found)[usable].ravel(), rcond=None)[0]
        rotated = rotated @ rotations(np.asarray(step[None], np.float64))[0].T
    with np.errstate(all="ignore"):
        return other.project(rotated) - pixels


def cross_validate(fit: Fit, used: Flags) -> CrossValidation:
    """Leaves out one group of views after the other. `used` marks the corners that count here."""
    seen = fit.seen.only(used)
    cameras = []
    squares = 0.0
    for group in groups(np.unique(seen.view)):
        left_out = np.isin(seen.view, group)
        trained = solve(fit.solution.camera, fit.solution.poses, seen.only(~left_out))
        cameras.append(trained.camera)
        squares += float(np.sum(_held_out(trained.camera, fit, seen.only(left_out)) ** 2))
    return CrossValidation(cameras, float(np.sqrt(squares / max(len(seen.view), 1))))


def _held_out(camera: Camera, fit: Fit, seen: Observations) -> Floats:
    nothing = np.zeros(len(camera.values), np.bool_)
    return solve(camera, fit.solution.poses, seen, free=nothing).residuals


def groups(views: Indices) -> list[Indices]:
    """The views in random groups of equal size; the same ones at every call."""
    mixed = np.random.default_rng(0).permutation(views)
    return [np.asarray(part, np.int64) for part in np.array_split(mixed, min(GROUPS, len(views)))]
