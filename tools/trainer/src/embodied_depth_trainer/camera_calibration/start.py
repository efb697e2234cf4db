"""First guesses of a camera and of the board's poses, from a series of focal lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.camera import COEFFICIENTS, FISHEYE, Camera
from embodied_depth_trainer.camera_calibration.poses import Poses, guess_poses
from embodied_depth_trainer.camera_calibration.solve import Solution, project, solve
from embodied_depth_trainer.camera_calibration.views import Observations

# Focal lengths to begin with, in widths of the image: a fisheye lens of 220 degrees to a telephoto lens of 14 degrees.
FOCAL_LENGTHS = np.geomspace(0.25, 4.0, 13)
# Views that a guess is judged by.
JUDGED = 12
# Guesses that are refined before one is taken.
TRIED = 3
# Weights of corners in the first search fall off beyond this many pixels, so that a few wrong ones do not count.
TOLERANCE_PX = 2.0


@dataclass(frozen=True)
class _Guess:
    camera: Camera
    poses: Poses
    error_px: float


def begin(model: str, seen: Observations) -> Solution:
    """A solution near the best: focal length from a series, then all parameters with little weight on outliers."""
    spread = np.unique(np.linspace(0, seen.views - 1, JUDGED).astype(np.int64))
    judged = seen.of_views(spread)
    guesses = [_guess(model, judged, factor * seen.width) for factor in FOCAL_LENGTHS]
    best = sorted(guesses, key=lambda guess: guess.error_px)[:TRIED]
    solutions = [robust(guess.camera, guess.poses, judged) for guess in best]
    camera = min(solutions, key=lambda solution: _typical(solution.residuals)).camera
    return robust(camera, all_poses(camera, seen), seen)


def _guess(model: str, seen: Observations, focal_px: float) -> _Guess:
    values = np.zeros(4 + len(COEFFICIENTS[model]))
    values[:2] = focal_px
    values[2:4] = ((seen.width - 1) / 2, (seen.height - 1) / 2)
    camera = Camera(model, seen.width, seen.height, values)
    poses = all_poses(camera, seen)
    with np.errstate(all="ignore"):
        error = seen.pixels - project(camera, poses, seen)
    return _Guess(camera, poses, _typical(error))


def _typical(residuals: Floats) -> float:
    """Median length. A corner that cannot be projected counts as infinitely wrong."""
    lengths = np.linalg.norm(residuals, axis=1)
    return float(np.median(np.where(np.isfinite(lengths), lengths, np.inf)))


def all_poses(camera: Camera, seen: Observations) -> Poses:
    """A guess of each view's pose from its corners alone."""
    rays, _ = camera.rays(seen.pixels)
    return guess_poses(seen.points_mm, rays, seen.view)


def robust(camera: Camera, poses: Poses, seen: Observations) -> Solution:
    """Least squares in which corners far from their projection have little weight (Geman and McClure's function).

    The distortion is free only after the focal length: at first it would explain what a wrong focal length causes. The
    scale of the weights falls in steps, so that a poor start does not make all corners outliers.
    """
    few = np.zeros(len(camera.values), np.bool_)
    few[:2] = True
    # A fisheye lens without coefficients is a good one; a wide plumb bob needs its first ones at once.
    if camera.model != FISHEYE:
        few[4:6] = True
    solution = solve(camera, poses, seen, _weights(camera, poses, seen, 1.0), few, steps=15)
    for spread in (3.0, 1.0, 1.0, 1.0):
        weights = _weights(solution.camera, solution.poses, seen, spread)
        solution = solve(solution.camera, solution.poses, seen, weights, steps=25)
    return solution


def _weights(camera: Camera, poses: Poses, seen: Observations, spread: float) -> Floats:
    with np.errstate(all="ignore"):
        lengths = np.linalg.norm(seen.pixels - project(camera, poses, seen), axis=1)
    lengths = np.where(np.isfinite(lengths), lengths, 1e6)
    scale = spread * max(TOLERANCE_PX, 3.0 * float(np.median(lengths)))
    return np.asarray(1.0 / (1.0 + (lengths / scale) ** 2) ** 2)
