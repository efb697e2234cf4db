"""What the terminal and the head of `lens.toml` say about a calibration."""

from __future__ import annotations

import time

import numpy as np

from embodied_depth_trainer import __version__
from embodied_depth_trainer.camera_calibration import coverage
from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.board import Board
from embodied_depth_trainer.camera_calibration.calibration import Calibration
from embodied_depth_trainer.camera_calibration.camera import Camera

# Outlier corners that are listed one by one.
LISTED = 10


def percentiles(values: Floats) -> str:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return "unknown"
    p50, p90, largest = np.percentile(finite, [50, 90, 100])
    return f"p50 {p50:.3f}, p90 {p90:.3f}, max {largest:.3f} px"


def lines(found: Calibration) -> list[str]:
    """The report for the terminal."""
    seen = found.fit.kept
    counts = coverage.counts(seen.pixels, seen.width, seen.height)
    said = [f"left out {name}: its corners do not fit the other views" for name in found.fit.outlier_views()]
    said += _outliers(found)
    said += [
        f"{found.fit.views} views with {len(seen.view)} corners, rms of the residuals {found.fit.rms_px:.3f} px; "
        "corners in each part of the image:",
        coverage.picture(counts),
        found.choice,
        *_parameters(found),
        f"uncertainty of the projection at infinity, from the noise:  {percentiles(found.projected)}",
        f"the same by cross-validation ({len(found.validated.cameras)} groups of views): {percentiles(found.crossed)}",
    ]
    return said + [f"WARNING: {warning}" for warning in found.warnings]


def _outliers(found: Calibration) -> list[str]:
    corners = found.fit.outlier_corners()
    said = [f"left out corner {corner} of {view}: {length:.1f} px off" for view, corner, length in corners[:LISTED]]
    return said + ([f"left out {len(corners) - LISTED} more corners"] if len(corners) > LISTED else [])


def _parameters(found: Calibration) -> list[str]:
    rows = zip(found.camera.names, found.camera.values, found.deviations, strict=True)
    return [f"  {name:>2} {value:12.5f} +- {deviation:.5f}" for name, value, deviation in rows]


def provenance(found: Calibration, board: Board, source: str, skipped: int) -> list[str]:
    """The head of the file."""
    outside = len(found.fit.outlier_views())
    return [
        _made("calibrate-camera"),
        f"From {found.fit.views} views of {source}"
        + (f"; {skipped} without the board" if skipped else "")
        + (f"; {outside} left out as outliers" if outside else "")
        + ".",
        f"Board: {board.describe()}.",
        found.choice,
        f"Residuals: rms {found.fit.rms_px:.3f} px over {int(found.fit.used.sum())} corners.",
        f"Uncertainty of the projection at infinity: {percentiles(found.projected)};",
        f"by cross-validation: {percentiles(found.crossed)}.",
        *(f"WARNING: {warning}" for warning in found.warnings),
        *_advice(),
    ]


def imported(file: str, kind: str, camera: Camera) -> list[str]:
    return [
        _made("calibrate-camera import"),
        f"From {file}, {kind}, {camera.model}; its errors are unknown.",
        *_advice(),
    ]


def _made(command: str) -> str:
    when = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    return f"Intrinsics of the camera, by `embodied-depth {command}` {__version__} on {when}."


def _advice() -> list[str]:
    return ["Copy the keys of both tables into the robot's configuration, where they replace the old ones."]
