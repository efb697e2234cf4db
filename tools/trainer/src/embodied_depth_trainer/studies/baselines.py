"""What needs no learning, and what every network must be better than."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Nearest pixels are searched among every CELLth row and column, which is the grain of coarse depth.
CELL = 4


def fill_nearest(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fills the holes (0) of a depth image [H, W] with the depth of the nearest cell that has one. Without any depth it
    stays empty."""
    filled = _nearest(depth[::CELL, ::CELL]).repeat(CELL, axis=0).repeat(CELL, axis=1)
    return np.where(depth > 0, depth, filled[: depth.shape[0], : depth.shape[1]])


def _nearest(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same for every single pixel, by jump flooding (Rong and Tan 2006), which now and then finds a pixel that is
    slightly farther away than the nearest."""
    if not depth.any():
        return depth
    height, width = depth.shape
    # Row and column of every pixel [2, H, W].
    pixels: NDArray[np.int64] = np.indices(depth.shape)
    # The nearest pixel with depth that has been found so far; far outside where there is none yet.
    nearest: NDArray[np.int64] = np.where(depth > 0, pixels, -4 * (height + width))
    step = 1 << (max(height, width) - 1).bit_length()
    while step := step // 2:
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)):
            rows = (pixels[0] + down * step).clip(0, height - 1)
            columns = (pixels[1] + right * step).clip(0, width - 1)
            seen = nearest[:, rows, columns]
            is_nearer = ((seen - pixels) ** 2).sum(0) < ((nearest - pixels) ** 2).sum(0)
            nearest = np.where(is_nearer, seen, nearest)
    filled: NDArray[np.float32] = depth[nearest[0], nearest[1]]
    return filled
