"""Fits one camera model to views, and finds the corners and the views that do not belong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats
from embodied_depth_trainer.camera_calibration.solve import Solution, solve
from embodied_depth_trainer.camera_calibration.start import begin
from embodied_depth_trainer.camera_calibration.views import Observations

# A view with fewer corners says little, and a pose of it could be a mirrored one.
LEAST_CORNERS = 8
# Corners with a larger residual are left out, in standard deviations of a coordinate. Of normally distributed ones it
# is one in 270,000 (exp(-25/2)), so that leaving them out does not make the noise seem smaller than it is.
OUTLIER = 5.0
# A view whose typical residual is this many times that of all views is left out.
OUTLIER_VIEW = 3.0
# Median length of a residual over the standard deviation of its coordinates, if they are normally distributed.
MEDIAN_LENGTH = float(np.sqrt(2 * np.log(2)))
# No view and no corner is left out for residuals that are small for this noise: 0.2 and 0.3 pixels do no harm.
LEAST_NOISE_PX = 0.06
ROUNDS = 8


@dataclass(frozen=True)
class Fit:
    """One model's solution, and what it was made from."""

    solution: Solution
    seen: Observations
    """All corners that were detected."""
    used: Flags
    """Which of them count [n]."""

    @property
    def residuals(self) -> Floats:
        return self.solution.residuals

    @property
    def kept(self) -> Observations:
        return self.seen.only(self.used)

    @property
    def views(self) -> int:
        """Number of views that count."""
        return len(np.unique(self.seen.view[self.used]))

    @property
    def noise_px(self) -> float:
        """Standard deviation of a corner's coordinate, from the residuals of the corners that count."""
        count = 2 * int(self.used.sum()) - len(self.solution.camera.values) - 6 * self.views
        return float(np.sqrt(np.sum(self.residuals[self.used] ** 2) / max(count, 1)))

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of the corners that count."""
        return float(np.sqrt(np.mean(np.sum(self.residuals[self.used] ** 2, axis=1))))

    @property
    def covariance(self) -> Floats:
        """Covariance of the intrinsics, from the noise and from how the residuals depend on them."""
        return np.asarray(np.linalg.pinv(self.solution.information) * self.noise_px**2)

    def outlier_views(self) -> list[str]:
        counts = np.bincount(self.seen.view[self.used], minlength=self.seen.views)
        return [name for name, count in zip(self.seen.names, counts, strict=True) if count == 0]

    def outlier_corners(self) -> list[tuple[str, int, float]]:
        """View, number on the board and residual of corners that were left out of views that count."""
        outside = set(self.outlier_views())
        lengths = np.linalg.norm(self.residuals, axis=1)
        found = [
            (self.seen.names[self.seen.view[index]], int(self.seen.corner[index]), float(lengths[index]))
            for index in np.flatnonzero(~self.used)
        ]
        return sorted((row for row in found if row[0] not in outside), key=lambda row: -row[2])


def fit(model: str, seen: Observations) -> Fit:
    """The least squares of all corners but outliers."""
    solution = begin(model, seen)
    used = inliers(solution.residuals, seen)
    for _ in range(ROUNDS):
        solution = solve(solution.camera, solution.poses, seen, used.astype(np.float64))
        found = inliers(solution.residuals, seen)
        if np.array_equal(found, used):
            break
        used = found
    return Fit(solution, seen, used)


def inliers(residuals: Floats, seen: Observations) -> Flags:
    """The corners whose residual is that of noise, in views in which most are so."""
    lengths = np.linalg.norm(residuals, axis=1)
    lengths = np.where(np.isfinite(lengths), lengths, np.inf)
    medians = np.array([np.median(lengths[seen.view == view]) for view in range(seen.views)])
    # The median over views, so that a single picture with many corners does not decide.
    noise = max(float(np.median(medians)) / MEDIAN_LENGTH, LEAST_NOISE_PX)
    good = lengths <= OUTLIER * noise
    counts = np.bincount(seen.view[good], minlength=seen.views)
    good_views = (medians <= OUTLIER_VIEW * MEDIAN_LENGTH * noise) & (counts >= LEAST_CORNERS)
    return np.asarray(good & good_views[seen.view], np.bool_)
