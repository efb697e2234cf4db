"""Plots of a loop: accuracy against frames, and depth beside the ground truth."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from torch import nn

from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.studies.evaluation import predict
from embodied_depth_trainer.studies.views import Views

# Upper end of the colour scale of depth, metres.
SHOWN_DEPTH_M = 5.0
SHOWN_DRIVEN = 3


def save(figure: Figure, file: Path) -> None:
    stream = io.BytesIO()
    # Without the program's version, the same numbers give the same file.
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_atomically(stream.getvalue(), file)


def draw_curve(curves: dict[str, dict[str, list[tuple[int, float]]]], file: Path) -> None:
    """Draws delta1 against frames: a panel per curve, with a line for the network and each baseline."""
    figure = Figure((7 * len(curves), 4.2), layout="constrained")
    axes = figure.subplots(1, len(curves), squeeze=False)
    for axis, (title, lines) in zip(axes[0], curves.items(), strict=True):
        for (name, points), style in zip(lines.items(), ("o-", "--", ":"), strict=False):
            axis.plot(*zip(*points, strict=True), style, label=name)
        axis.set(title=title, xlabel="frames of the robot", ylabel="delta1 (median-scaled)", ylim=(0, 1))
        axis.title.set_fontsize(9)
        axis.grid(alpha=0.3)
        axis.legend(loc="lower right", fontsize=8)
    save(figure, file)


def draw_views(views: Views, network: nn.Module, depth_range_m: tuple[float, float], title: str, file: Path) -> None:
    """Draws some test views, the last of them without parallax: image, truth, coarse depth and prediction."""
    frames = views.frames
    driven = np.flatnonzero(views.has_truth & ~views.rotated)
    rotated = np.flatnonzero(views.has_truth & views.rotated)
    shown = np.concatenate([driven[:: max(1, len(driven) // SHOWN_DRIVEN)][:SHOWN_DRIVEN], rotated[:1]])
    predicted, _ = predict(network, frames, shown, depth_range_m)
    assert frames.truth_mm is not None
    assert frames.coarse is not None
    heads = ("image", "truth", "coarse depth", "network")
    figure = Figure((14, 1.25 * len(shown) + 0.7), layout="constrained")
    axes = figure.subplots(len(shown), 4, squeeze=False)
    for row, index, depth in zip(axes, shown, predicted, strict=True):
        truth = frames.truth_mm[index] / 1000.0
        coarse = frames.coarse[index, 0] / 1000.0
        row[0].imshow(frames.rgb[index])
        for axis, metres in zip(row[1:], (truth, coarse, depth), strict=True):
            axis.imshow(np.where(metres > 0, metres, np.nan), cmap="turbo_r", vmin=0, vmax=SHOWN_DEPTH_M)
        for axis, head in zip(row, heads, strict=True):
            axis.set(xticks=[], yticks=[])
            axis.set_title(head if index == shown[0] else "", fontsize=9)
        row[0].set_ylabel("rotated" if views.rotated[index] else "driven", fontsize=8)
    figure.suptitle(f"{title}; red is near, {SHOWN_DEPTH_M:g} m and more is blue", fontsize=9)
    save(figure, file)
