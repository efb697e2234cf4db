"""Views of a board: which of its corners were seen where in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats, Indices


@dataclass(frozen=True)
class View:
    """The corners of the board in one picture."""

    name: str
    """File or number of the picture, for messages."""
    corners: Indices
    """Numbers of the corners on the board [n]."""
    points_mm: Floats
    """The same corners on the board [n, 3]."""
    pixels: Floats
    """And in the picture [n, 2]."""


@dataclass(frozen=True)
class Observations:
    """All corners of all views in one table, sorted by view, as the solver needs them."""

    names: tuple[str, ...]
    width: int
    height: int
    view: Indices
    """The view of each corner [n]."""
    corner: Indices
    """The corner's number on the board [n]."""
    points_mm: Floats
    pixels: Floats

    @property
    def views(self) -> int:
        return len(self.names)

    def only(self, used: Flags) -> Observations:
        """The corners that `used` [n] marks; all views keep their numbers."""
        return Observations(
            self.names,
            self.width,
            self.height,
            self.view[used],
            self.corner[used],
            self.points_mm[used],
            self.pixels[used],
        )

    def of_views(self, chosen: Sequence[int] | Indices) -> Observations:
        """The chosen views, in increasing order and numbered anew."""
        number = np.full(self.views, -1, np.int64)
        order = np.sort(np.asarray(chosen, np.int64))
        number[order] = np.arange(len(order))
        kept = self.only(number[self.view] >= 0)
        names = tuple(self.names[index] for index in order)
        return Observations(names, self.width, self.height, number[kept.view], kept.corner, kept.points_mm, kept.pixels)


def table(views: Sequence[View], size: tuple[int, int]) -> Observations:
    """The views as one table; `size` is the images' width and height."""
    counts = [len(view.corners) for view in views]
    return Observations(
        tuple(view.name for view in views),
        *size,
        np.repeat(np.arange(len(views), dtype=np.int64), counts),
        np.concatenate([view.corners for view in views]),
        np.concatenate([view.points_mm for view in views]),
        np.concatenate([view.pixels for view in views]).astype(np.float64),
    )
