"""What a calibration must fulfil. Every refusal says what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration import coverage
from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.camera import Camera
from embodied_depth_trainer.camera_calibration.fit import Fit
from embodied_depth_trainer.camera_calibration.views import Observations
from embodied_depth_trainer.errors import TrainerError

# Each of ten groups of the cross-validation needs a view. OpenCV's tutorial asks for ten, too.
LEAST_VIEWS = 10
# Less of the image with corners is refused, or mentioned.
LEAST_COVERAGE = 0.6
GOOD_COVERAGE = 0.85
# Normals of the board must differ by this much from their mean, in a fifth of the views. The focal length follows from
# foreshortening: at 10 degrees it is 1.5 %, which a detector measures; below it is lost in the noise.
LEAST_TILT_DEG = 10.0
TILT_PERCENTILE = 80
# The robot's range of allowed values, `[devices.lens]` in firmware-host/src/config/devices.rs.
FOCAL_PX = (1.0, 100_000.0)
CENTRE_PX = 100_000.0
# A focal length that is 1 % wrong makes all depth from motion 1 % wrong, and moves the edges of a 640 pixels wide image
# by 3 pixels.
LARGEST_FOCAL_DEVIATION = 0.01
TILT_ADVICE = "tilt the board by 20 to 45 degrees to the left, right, top and bottom in different images"


@dataclass(frozen=True)
class Limits:
    """What the user may change."""

    rms_px: float = 1.0
    """Largest root mean square residual."""
    coverage: float = LEAST_COVERAGE
    """Least share of the image's parts with corners."""
    views: int = LEAST_VIEWS


def require_views(seen: Observations, limits: Limits) -> None:
    if not (np.isfinite(seen.pixels).all() and np.isfinite(seen.points_mm).all()):
        bad = seen.view[~np.isfinite(seen.pixels).all(axis=1)]
        names = ", ".join(seen.names[view] for view in np.unique(bad))
        raise TrainerError(f"corners of {names or 'the board'} have coordinates that are no numbers; leave them out")
    if seen.views < limits.views:
        raise TrainerError(
            f"{seen.views} views with the board are too few, {limits.views} are needed and 30 are good; take more "
            "images, with the board larger, sharp, in even light and with the right --kind and --squares"
        )
    found = coverage.counts(seen.pixels, seen.width, seen.height)
    if coverage.share(found) < limits.coverage:
        raise TrainerError(
            f"only {coverage.share(found):.0%} of the image has corners, and {limits.coverage:.0%} are needed, because "
            f"distortion is only known there; take images with the board at {coverage.missing(found)}. "
            f"Corners in each part of the image:\n{coverage.picture(found)}\n"
            "--least-coverage allows less, for a fisheye lens whose picture is a circle"
        )


def no_fit(model: str | None = None) -> TrainerError:
    which = "no model fits" if model is None else f"the model {model} does not fit"
    return TrainerError(
        f"{which} the views; check --kind, --squares, --spacing and --legacy-pattern against the print; {TILT_ADVICE}"
    )


def require_fit(found: Fit, limits: Limits) -> None:
    """The result must be finite, of enough views with tilted boards, and with small residuals."""
    if not (np.isfinite(found.solution.camera.values).all() and np.isfinite(found.rms_px)):
        raise no_fit(found.solution.camera.model)
    if found.views < limits.views:
        raise TrainerError(
            f"{found.views} of {found.seen.views} views agree with each other, {limits.views} are needed; these do "
            f"not: {', '.join(found.outlier_views())}. Take more images, without motion blur and with a flat board"
        )
    tilt = tilt_deg(found)
    if tilt < LEAST_TILT_DEG:
        raise TrainerError(
            f"the board is nearly parallel in all views (its normals differ by {tilt:.1f} degrees), so that the focal "
            f"length is not observable; {TILT_ADVICE}"
        )
    if found.rms_px > limits.rms_px:
        raise TrainerError(
            f"the residuals have an rms of {found.rms_px:.2f} pixels, above {limits.rms_px:g}; use a flat board (paper "
            "on glass), check --squares, --spacing and --legacy-pattern against the print, and take images without "
            "motion; --rms-limit allows more"
        )


def tilt_deg(found: Fit) -> float:
    """By how much the board's normals differ from their mean, in the more tilted fifth of the views."""
    normals = found.solution.poses.normals()[np.unique(found.kept.view)]
    axis = np.linalg.svd(normals, full_matrices=False)[2][0]
    angles = np.degrees(np.arccos(np.clip(np.abs(normals @ axis), 0.0, 1.0)))
    return float(np.percentile(angles, TILT_PERCENTILE))


def require_certainty(camera: Camera, deviations: Floats, better: str | None) -> None:
    """`better` names a model that predicts unseen views better than the one that was asked for."""
    focal = camera.values[:2]
    uncertain = float(np.max(deviations[:2] / focal))
    if not uncertain <= LARGEST_FOCAL_DEVIATION:
        if better is not None:
            raise TrainerError(
                f"the model {camera.model} does not fit this lens (focal length uncertain by {uncertain:.1%}); leave "
                f"--model out, or give --model {better}"
            )
        raise TrainerError(
            f"the focal length is uncertain by {uncertain:.1%}, above {LARGEST_FOCAL_DEVIATION:.0%}; {TILT_ADVICE}, "
            "and take more images with a larger board"
        )
    require_allowed(camera)


def require_allowed(camera: Camera) -> None:
    """The values must be in the ranges of `[devices.lens]`."""
    if not np.isfinite(camera.values).all():
        raise TrainerError("the intrinsics contain values that are no numbers; calibrate the camera again")
    for name, value in zip(camera.names[:2], camera.values[:2], strict=True):
        if not FOCAL_PX[0] <= value <= FOCAL_PX[1]:
            raise TrainerError(f"{name} = {value:g} is not within {FOCAL_PX[0]:g} to {FOCAL_PX[1]:g} pixels")
    for name, value in zip(camera.names[2:4], camera.values[2:4], strict=True):
        if abs(value) > CENTRE_PX:
            raise TrainerError(f"{name} = {value:g} is not within +-{CENTRE_PX:g} pixels")


def coverage_warnings(found: Fit) -> list[str]:
    seen = found.kept
    counts = coverage.counts(seen.pixels, seen.width, seen.height)
    if coverage.share(counts) >= GOOD_COVERAGE:
        return []
    return [
        f"{coverage.share(counts):.0%} of the image has corners; the rest is extrapolated. Take images with the "
        f"board at {coverage.missing(counts)}"
    ]
