"""Which parts of the image have corners. Distortion is only known where there are some."""

from __future__ import annotations

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats, Indices

COLUMNS = 6
ROWS = 6
# A part with fewer corners counts as empty.
LEAST_CORNERS = 3

_ACROSS = ("left", "middle", "right")
_DOWN = ("top", "centre", "bottom")


def counts(pixels: Floats, width: int, height: int) -> Indices:
    """Corners in each part [rows, columns]."""
    column = np.clip((pixels[:, 0] + 0.5) / width * COLUMNS, 0, COLUMNS - 1).astype(np.int64)
    row = np.clip((pixels[:, 1] + 0.5) / height * ROWS, 0, ROWS - 1).astype(np.int64)
    return np.bincount(row * COLUMNS + column, minlength=ROWS * COLUMNS).reshape(ROWS, COLUMNS)


def share(found: Indices) -> float:
    """Share of the parts that have corners."""
    return float(np.mean(found >= LEAST_CORNERS))


def missing(found: Indices) -> str:
    """Where corners lack, in words: `top left, bottom right`."""
    empty = found < LEAST_CORNERS
    names = []
    for row, down in enumerate(_DOWN):
        rows = slice(row * ROWS // 3, (row + 1) * ROWS // 3)
        for column, across in enumerate(_ACROSS):
            columns = slice(column * COLUMNS // 3, (column + 1) * COLUMNS // 3)
            if empty[rows, columns].any():
                names.append("the middle" if (down, across) == ("centre", "middle") else _name(down, across))
    return ", ".join(names)


def _name(down: str, across: str) -> str:
    if down == "centre":
        return across
    return down if across == "middle" else f"{down} {across}"


def picture(found: Indices) -> str:
    """The counts as lines of text, in the places of the parts."""
    return "\n".join("  " + " ".join(f"{count:5d}" for count in row) for row in found)
