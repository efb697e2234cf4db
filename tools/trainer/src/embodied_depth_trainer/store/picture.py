"""Draws what is in a store: frames over time, and the segments of each run, coloured by what happened in them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import accumulate
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.store.catalogue import query
from embodied_depth_trainer.store.store import Store

QUIET = "#bbbbbb"
# Kinds of events with a name and a colour, the most important first: a segment has the colour of the first that
# occurred in it. The colours are Okabe and Ito's, which eyes that do not tell red from green distinguish, too.
EVENTS = (
    (("lost", "stands_lost"), "lost", "#cc79a7"),
    (("wheels_contradicted",), "wheels contradicted", "#56b4e9"),
    (("safety",), "safety (trip, slowed, fault, armed)", "#d55e00"),
    (("no_depth", "stands_without_frames"), "no depth", "#0072b2"),
    (("goal_dropped",), "goal dropped", "#e69f00"),
)
# Runs with a line of their own; more would not be legible.
MOST_RUNS = 60
SQL = "SELECT folder, began, frames, events FROM segments ORDER BY folder, length(segment), segment"


@dataclass(frozen=True)
class DrawnSegment:
    """What is drawn of one segment."""

    began: datetime | None
    frames: int
    color: str


def color_of(events: dict[str, int]) -> str:
    """The colour of a segment with these events."""
    occurred = {kind for kind, count in events.items() if count > 0}
    return next((color for kinds, _, color in EVENTS if occurred.intersection(kinds)), QUIET)


def runs_of(store: Store) -> dict[str, list[DrawnSegment]]:
    """The segments of every run, in their order; the latest run is the last, runs without a date are the first."""
    found: dict[str, list[DrawnSegment]] = {}
    for folder, began, frames, events in query(store.folder, SQL).rows:
        found.setdefault(folder, []).append(DrawnSegment(began, frames, color_of(events)))
    return dict(sorted(found.items(), key=lambda run: run[1][0].began or datetime.min))


def draw(store: Store, file: Path) -> None:
    runs = runs_of(store)
    if not runs:
        raise TrainerError(f"{store.folder} holds no segment; prepare recordings with `embodied-depth prepare`")
    shown = list(runs.items())[-MOST_RUNS:]
    figure = Figure((11, 4.2 + 0.25 * len(shown)), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(3, 1 + 0.25 * len(shown)))
    _draw_total(above, [segment for run in runs.values() for segment in run])
    _draw_runs(below, shown, len(runs))
    stream = io.BytesIO()
    # Without the program's version, the same store gives the same file.
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_atomically(stream.getvalue(), file)


def _draw_total(axis: Axes, segments: Sequence[DrawnSegment]) -> None:
    """Frames in the store against the date of recording."""
    dated = sorted((segment.began, segment.frames) for segment in segments if segment.began is not None)
    undated = sum(segment.frames for segment in segments) - sum(frames for _, frames in dated)
    axis.set(title="frames recorded" + (f" ({undated} more without a date)" if undated else ""), ylabel="frames")
    if dated:
        dates = [began for began, _ in dated]
        axis.step(dates, list(accumulate(frames for _, frames in dated)), "k.-", where="post")  # type: ignore[arg-type]
        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        axis.xaxis.set_major_locator(locator)
        axis.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)


def _draw_runs(axis: Axes, runs: Sequence[tuple[str, list[DrawnSegment]]], count: int) -> None:
    """A line for each run with one bar for each segment, the latest run at the top."""
    for row, (_, segments) in enumerate(runs):
        widths = [segment.frames for segment in segments]
        lefts = [end - width for end, width in zip(accumulate(widths), widths, strict=True)]
        axis.barh(row, widths, 0.8, lefts, color=[segment.color for segment in segments], edgecolor="white")
    axis.set_yticks(range(len(runs)), [_label(folder, segments[0]) for folder, segments in runs], fontsize=8)
    axis.set(xlabel="frames of the run", title=f"the latest {len(runs)} of {count} runs, by segment")
    patches = [Patch(color=color, label=name) for _, name, color in EVENTS] + [
        Patch(color=QUIET, label="none of these")
    ]
    axis.legend(handles=patches, fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))


def _label(folder: str, first: DrawnSegment) -> str:
    """The robot's folder, the run and its date: `pull-buffer` makes a folder for each robot."""
    name = "/".join(folder.rstrip("/").split("/")[-2:])
    return name if first.began is None else f"{name}, {first.began:%Y-%m-%d %H:%M}"
