"""How much better depth gets in one home while a robot drives there and its network is trained on what it recorded.

A robot explores a home. Each time that it has driven on for some frames, the network is trained further on everything
recorded so far, as `watch` does for a real robot, and is measured on views of the home from random places of its free
floor. Ground truth exists only in these views. The robot drives without the networks, so that all of them are trained
on the same recording.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from mcap.reader import make_reader

from embodied_depth_trainer.data.messages import IMAGE, segments
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.runtime import OnnxNetwork
from embodied_depth_trainer.studies.evaluation import JOINED
from embodied_depth_trainer.studies.plots import save
from embodied_depth_trainer.studies.views import Rows, Views

RESULT_FILE = "result.json"
# The name of the network's rows in the metrics, whichever file it comes from.
NETWORK = "network"
# Frames of the robot in a minute.
FRAMES_PER_MINUTE = 600
PARTS = {"all": "all views", "drive": "after driving", "turn": "after a rotation on the spot"}

# Lines of what needs no network.
STYLES = {"dense": "--", "coarse": "-.", "constant": ":"}
# Least share of the pixels with coarse depth for its line to be drawn.
MOSTLY = 0.5
LABELS = {
    "dense": "dense depth, without a network",
    "coarse": "coarse depth",
    "constant": "constant (each view's median of the truth)",
}


@dataclass(frozen=True)
class AdaptationSettings:
    """The settings of a study. The names are part of the formats of `settings.json` and `result.json`."""

    scene: str
    policy: str = "active"
    seed: int = 1
    """Seed of the robot."""
    after: tuple[int, ...] = (1500, 3000, 6000, 12000)
    """Frames after which the network is trained; the last is the length of the drive."""
    steps: int = 1000
    """Training steps of a round."""
    views: int = 160
    views_seed: int = 1000
    init: str | None = None
    """File of the network to begin with; `None`: random weights."""

    def __post_init__(self) -> None:
        if not self.after or list(self.after) != sorted(set(self.after)) or self.after[0] < 1:
            raise TrainerError(f"--after {' '.join(map(str, self.after))} are no growing numbers of frames")


def complete(run: Path, frames: int) -> tuple[list[Path], int]:
    """The segments of a run that are complete after this many frames, and the number of frames in them."""
    found: list[Path] = []
    count = 0
    for segment in segments(run):
        inside = _frames_of(segment)
        if count + inside > frames:
            break
        found.append(segment)
        count += inside
    return found, count


def check_rounds(run: Path, after: Sequence[int]) -> None:
    """Refuses rounds in which no new segment would be complete."""
    counts = [0, *(complete(run, frames)[1] for frames in after)]
    if any(now <= before for before, now in itertools.pairwise(counts)):
        raise TrainerError(
            f"after {' '.join(map(str, after))} frames, segments with {' '.join(map(str, counts[1:]))} frames are "
            "complete, and each round needs a new one; give --after numbers that are further apart"
        )


def pull(run: Path, frames: int, pulled: Path) -> int:
    """Copies the segments of a run that are complete after this many frames into `pulled`, as pull-buffer would have
    fetched them by then. Returns the number of frames in them."""
    folder = pulled / run.name
    folder.mkdir(parents=True, exist_ok=True)
    found, count = complete(run, frames)
    for segment in found:
        copy = folder / segment.name
        if not copy.exists():
            try:
                os.link(segment, copy)
            except OSError:
                shutil.copy2(segment, copy)
    return count


def _frames_of(segment: Path) -> int:
    with segment.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        raise TrainerError(f"{segment} has no index; let the robot finish its run")
    named = {channel.id: channel.topic for channel in summary.channels.values()}
    counts = summary.statistics.channel_message_counts
    return sum(count for channel, count in counts.items() if named[channel] == IMAGE)


def measured(network: Path, views: Views) -> Rows:
    """The metrics of an exported network, and of what needs no network, on the views."""
    loaded = OnnxNetwork(network)
    return views.evaluate({NETWORK: loaded}, loaded.depth_range_m)


def as_table(curve: Sequence[dict[str, Any]]) -> str:
    """The share of all pixels that are right as a table in Markdown."""
    lines = []
    for part, title in PARTS.items():
        if part not in curve[0]["metrics"]:
            continue
        rows = curve[0]["metrics"][part]
        without = ", ".join(
            f"{name} {rows[name]['right']:.3f}" for name in ("constant", "coarse", "dense") if name in rows
        )
        names = [name for name in (NETWORK, NETWORK + JOINED) if name in rows]
        lines += [f"Right of all pixels, {title} ({without}):", ""]
        lines += [f"| minutes driven | training steps | {' | '.join(names)} |", "|---|---|" + "---|" * len(names)]
        for point in curve:
            found = point["metrics"][part]
            cells = [f"{point['frames'] / FRAMES_PER_MINUTE:.1f}", str(point["steps"])]
            lines.append(" | ".join(["", *cells, *(f"{found[name]['right']:.3f}" for name in names), ""]).strip())
        lines.append("")
    return "\n".join(lines)


def _shown(rows: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """The rows that are drawn. Coarse depth is left out where it covers nothing or little."""
    names = (NETWORK, NETWORK + JOINED, *STYLES)
    return {name: rows[name] for name in names if name in rows and (name != "coarse" or rows[name]["share"] > MOSTLY)}


def draw(curve: Sequence[dict[str, Any]], title: str, file: Path) -> None:
    """Draws the share of all pixels that are right against the minutes driven, for each kind of views."""
    parts = [part for part in PARTS if part in curve[0]["metrics"]]
    figure = Figure((4.6 * len(parts), 3.8), layout="constrained")
    axes = figure.subplots(1, len(parts), squeeze=False, sharey=True)
    minutes = [point["frames"] / FRAMES_PER_MINUTE for point in curve]
    shown = [row["right"] for point in curve for part in parts for row in _shown(point["metrics"][part]).values()]
    lowest = math.floor(10 * min(shown)) / 10
    for axis, part in zip(axes[0], parts, strict=True):
        rows = [point["metrics"][part] for point in curve]
        for name in (NETWORK + JOINED, NETWORK):
            if name in rows[0]:
                axis.plot(minutes, [row[name]["right"] for row in rows], "o-", label=name)
        for name, style in STYLES.items():
            if name in _shown(rows[0]):
                axis.axhline(rows[0][name]["right"], linestyle=style, color="grey", label=LABELS[name])
        axis.set(title=PARTS[part], xlabel="minutes driven", ylim=(lowest, 1))
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("share of all pixels within 25 %")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(f"{title} (simulated)", fontsize=10)
    save(figure, file)
