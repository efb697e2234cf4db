"""`meta/stats.json`: the statistics by which training normalizes its inputs."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""The quantiles that LeRobot uses."""


class Numbers:
    """All values of a numeric feature."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float64]] = []

    def push(self, values: NDArray[Any]) -> None:
        """Rows of values, or one value in each row."""
        self._parts.append(np.asarray(values, np.float64).reshape(len(values), -1))

    def plain(self) -> dict[str, Any]:
        values = np.concatenate(self._parts)
        stats: dict[str, Any] = {
            "min": values.min(0).tolist(),
            "max": values.max(0).tolist(),
            "mean": values.mean(0).tolist(),
            # Of the population.
            "std": values.std(0).tolist(),
            "count": [len(values)],
        }
        return stats | {name: np.quantile(values, q, axis=0).tolist() for name, q in QUANTILES.items()}


class Pixels:
    """A histogram of each channel over all images: all pixels count, and none is kept."""

    def __init__(self) -> None:
        self._counts = np.zeros((3, 256), np.int64)
        self._images = 0

    def push(self, rgb: NDArray[np.uint8]) -> None:
        """An image [height, width, 3]."""
        for counts, values in zip(self._counts, rgb.reshape(-1, 3).T, strict=True):
            counts += np.bincount(values, minlength=256)
        self._images += 1

    def plain(self) -> dict[str, Any]:
        """The statistics of each channel in the shape channels x 1 x 1, for values from 0 to 1 as in LeRobot's
        images."""
        stats: dict[str, Any] = {
            "min": self._each(lambda counts: _pixel(counts, 0)),
            "max": self._each(lambda counts: _pixel(counts, int(counts.sum()) - 1)),
            "mean": self._each(_mean),
            "std": self._each(_deviation),
            "count": [self._images],
        }
        return stats | {name: self._each(partial(_quantile, q)) for name, q in QUANTILES.items()}

    def _each(self, statistic: Callable[[NDArray[np.int64]], float]) -> list[list[list[float]]]:
        return [[[statistic(counts) / 255]] for counts in self._counts]


_VALUES = np.arange(256)


def _mean(counts: NDArray[np.int64]) -> float:
    return float(counts @ _VALUES / counts.sum())


def _deviation(counts: NDArray[np.int64]) -> float:
    return math.sqrt(float(counts @ (_VALUES - _mean(counts)) ** 2 / counts.sum()))


def _pixel(counts: NDArray[np.int64], rank: int) -> float:
    """The value of a rank, counted from 0."""
    return float(np.searchsorted(counts.cumsum(), rank, side="right"))


def _quantile(q: float, counts: NDArray[np.int64]) -> float:
    """With linear interpolation between the two nearest values, as NumPy does by default."""
    part, below = math.modf(q * (int(counts.sum()) - 1))
    low = _pixel(counts, int(below))
    return low if part == 0 else low + part * (_pixel(counts, int(below) + 1) - low)
