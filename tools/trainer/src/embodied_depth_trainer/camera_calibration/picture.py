"""The picture of a calibration: where corners were, what remains of them, and how uncertain the projection is."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from embodied_depth_trainer.camera_calibration import coverage
from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.calibration import Calibration
from embodied_depth_trainer.files import write_atomically

# The longest residual is drawn about this long, as a share of the image's width.
LONGEST_ARROW = 0.06
# Lines of both maps, pixels.
LEVELS = [step * 10.0**power for power in range(-4, 5) for step in (1, 2, 5)]
# Okabe and Ito's blue and vermilion, which eyes that do not tell red from green distinguish, too.
BLUE = "#0072b2"
VERMILION = "#d55e00"


def draw(found: Calibration, title: str, file: Path) -> None:
    camera = found.camera
    height = 5.2 * camera.height / camera.width
    figure = Figure((12.4, 2 * height + 1.9), layout="constrained")
    axes = figure.subplots(2, 2)
    for axis in axes.flat:
        axis.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal")
        axis.tick_params(labelsize=7)
    _coverage(axes[0, 0], found)
    _residuals(axes[0, 1], found)
    _maps(figure, axes[1], found)
    figure.suptitle(title, fontsize=10)
    stream = io.BytesIO()
    # Without the program's version, the same numbers give the same file.
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_atomically(stream.getvalue(), file)


def _coverage(axis: Axes, found: Calibration) -> None:
    """Corners of the views, and a shade on the parts of the image that have none."""
    seen = found.fit.kept
    counts = coverage.counts(seen.pixels, seen.width, seen.height)
    empty = np.ma.masked_where(counts >= coverage.LEAST_CORNERS, np.ones(counts.shape))
    extent = (-0.5, seen.width - 0.5, seen.height - 0.5, -0.5)
    axis.imshow(empty, extent=extent, cmap="Reds", vmin=0, vmax=4, aspect="equal", interpolation="nearest")
    x, y = seen.pixels.T
    axis.scatter(x, y, s=4, c=BLUE, linewidths=0, alpha=0.7)
    outside = found.fit.seen.only(~found.fit.used)
    if len(outside.view):
        x, y = outside.pixels.T
        axis.scatter(x, y, s=16, c=VERMILION, marker="x", linewidths=0.8, label="left out")
        axis.legend(fontsize=7, loc="upper right")
    for column in np.arange(1, coverage.COLUMNS) * seen.width / coverage.COLUMNS - 0.5:
        axis.axvline(column, color="0.85", linewidth=0.6, zorder=0)
    for row in np.arange(1, coverage.ROWS) * seen.height / coverage.ROWS - 0.5:
        axis.axhline(row, color="0.85", linewidth=0.6, zorder=0)
    axis.set_title(
        f"{len(seen.view)} corners of {found.fit.views} views; {coverage.share(counts):.0%} of the image", fontsize=9
    )


def _residuals(axis: Axes, found: Calibration) -> None:
    seen = found.fit.kept
    residuals = found.fit.residuals[found.fit.used]
    longest = float(np.percentile(np.linalg.norm(residuals, axis=1), 99))
    factor = _round(LONGEST_ARROW * seen.width / max(longest, 1e-9))
    arrows = axis.quiver(
        *seen.pixels.T,
        *(factor * residuals.T),
        np.linalg.norm(residuals, axis=1),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.0018,
        cmap="viridis_r",
        clim=(0, longest),
    )
    colours = axis.figure.colorbar(arrows, ax=axis, shrink=0.85, pad=0.01)
    colours.ax.tick_params(labelsize=7)
    colours.set_label("pixels", fontsize=8)
    axis.set_title(f"residuals, {factor:g} times as long; rms {found.fit.rms_px:.3f} px", fontsize=9)


def _round(value: float) -> float:
    """The next lower 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))


def _maps(figure: Figure, axes: Floats, found: Calibration) -> None:
    """Both maps with one scale of colours, so that a glance shows whether they agree."""
    values = np.concatenate([found.projected.ravel(), found.crossed.ravel()])
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite[finite > 0], [2, 98]) if np.any(finite > 0) else (0.1, 1.0)
    # Whole steps of the series 1, 2, 5; at least a factor of ten, so that small differences do not seem large.
    top = _ceiling(float(high))
    bottom = min(_round(float(low)), top / 10)
    titles = ("uncertainty from the noise of the corners", "cross-validation: calibrations without some views")
    shown: AxesImage | None = None
    for axis, values, title in zip(axes, (found.projected, found.crossed), titles, strict=True):
        shown = _map(axis, found, values, bottom, top)
        finite = values[np.isfinite(values)]
        p50, p90 = np.percentile(finite, [50, 90]) if len(finite) else (np.nan, np.nan)
        axis.set_title(f"{title}: p50 {p50:.2f}, p90 {p90:.2f} px", fontsize=9)
    assert shown is not None
    colours = figure.colorbar(shown, ax=list(axes), shrink=0.85, pad=0.01, extend="both")
    ticks = [level for level in LEVELS if 0.99 * bottom <= level <= 1.01 * top]
    colours.set_ticks(ticks, labels=[f"{level:g}" for level in ticks])
    colours.ax.minorticks_off()
    colours.ax.tick_params(labelsize=7)
    colours.set_label("pixels, root mean square", fontsize=8)


def _map(axis: Axes, found: Calibration, values: Floats, bottom: float, top: float) -> AxesImage:
    camera = found.camera
    rows, columns = values.shape
    half = np.array([(camera.width - 1) / (columns - 1), (camera.height - 1) / (rows - 1)]) / 2
    extent = (-half[0], camera.width - 1 + half[0], camera.height - 1 + half[1], -half[1])
    axis.set_facecolor("0.75")
    image = axis.imshow(
        values, extent=extent, cmap="viridis", norm=LogNorm(bottom, top), aspect="equal", interpolation="bilinear"
    )
    x = np.linspace(0, camera.width - 1, columns)
    y = np.linspace(0, camera.height - 1, rows)
    lines = axis.contour(x, y, np.ma.masked_invalid(values), levels=LEVELS, colors="white", linewidths=0.7)
    axis.clabel(lines, fontsize=7, fmt="%g")
    axis.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))
    return image


def _ceiling(value: float) -> float:
    """The next higher 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-9)))
    return float(power * min(step for step in (1, 2, 5, 10) if step * power >= value))
