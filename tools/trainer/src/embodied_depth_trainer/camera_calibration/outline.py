"""Outlines of the black cells of a grid.

A printer's or a viewer's anti-aliasing leaves hairlines between rectangles that touch. An outline around cells that
belong together has none.
"""

from __future__ import annotations

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats

Corner = tuple[int, int]


def outline(black: Flags) -> list[Floats]:
    """Closed outlines [n, 2] as column and row of grid lines; holes have outlines of their own, in the other sense."""
    edges = _edges(np.pad(black, 1))
    loops = []
    while edges:
        start = next(iter(edges))
        loop = [start]
        corner = start
        while True:
            following = edges[corner].pop()
            if not edges[corner]:
                del edges[corner]
            if following == start:
                break
            loop.append(following)
            corner = following
        loops.append(np.array(loop, np.float64))
    return loops


def _edges(padded: Flags) -> dict[Corner, list[Corner]]:
    """Edges between black and white by where they begin; black is on the right."""
    edges: dict[Corner, list[Corner]] = {}
    rows, columns = padded.shape
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if not padded[row, column]:
                continue
            left, top, right, bottom = column - 1, row - 1, column, row
            if not padded[row - 1, column]:
                edges.setdefault((left, top), []).append((right, top))
            if not padded[row, column + 1]:
                edges.setdefault((right, top), []).append((right, bottom))
            if not padded[row + 1, column]:
                edges.setdefault((right, bottom), []).append((left, bottom))
            if not padded[row, column - 1]:
                edges.setdefault((left, bottom), []).append((left, top))
    return edges
