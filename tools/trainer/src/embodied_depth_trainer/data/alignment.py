"""Aligns the depth of a monocular network with depth that is known, by a scale and a shift of inverse depth.

A monocular network knows depth up to a scale, or inverse depth up to a scale and a shift (Ranftl et al. 2020, MiDaS),
and both differ from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Two cells determine scale and shift; the pair that most cells agree with is refined by least squares.
PAIRS = 300
REFINEMENTS = 5
# A cell agrees if its depth is within this of the known one.
LN_AGREES = np.log(1.25)
MIN_CELLS = 50
# Least inverse depth, 1/m, that aligned values may have: 50 m.
MIN_INVERSE = 0.02


@dataclass(frozen=True)
class Alignment:
    """Inverse depth in 1/m is scale x + shift of the network's x."""

    scale: float
    shift: float
    agreeing: float
    """Share of the known cells whose aligned depth is within 25 %."""
    constant: float
    """The same share for the median of the known depths: what any network reaches."""

    def depth_m(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        aligned: NDArray[np.float64] = 1 / (self.scale * x + self.shift).clip(min=MIN_INVERSE)
        return aligned


def align(x: NDArray[np.float64], known_m: NDArray[np.float64], weight: NDArray[np.float64]) -> Alignment | None:
    """Fits the network's x [P] (larger is nearer) to depths in metres [P] with weights [P]. Up to about half of the
    depths may be wrong. `None` if there are too few, or if nothing nearer is larger."""
    if len(x) < MIN_CELLS or np.ptp(x) <= 1e-6 * np.abs(x).max():
        return None
    # The same pairs for the same cells.
    random = np.random.default_rng(0)
    first, second = random.integers(len(x), size=(2, PAIRS))
    with np.errstate(divide="ignore", invalid="ignore"):
        scales = (1 / known_m[first] - 1 / known_m[second]) / (x[first] - x[second])
    shifts = 1 / known_m[first] - scales * x[first]
    rising = np.isfinite(scales) & (scales > 0)
    if not rising.any():
        return None
    candidates = list(zip(scales[rising].tolist(), shifts[rising].tolist(), strict=True))
    scale, shift = max(candidates, key=lambda pair: weight[_agrees(x, known_m, *pair)].sum())
    for _ in range(REFINEMENTS):
        good = _agrees(x, known_m, scale, shift)
        refined = _least_squares(x[good], known_m[good], weight[good])
        if refined is None or refined[0] <= 0:
            break
        scale, shift = refined
    agreeing, constant = (
        float(weight[_agrees(x, known_m, *line)].sum() / weight.sum())
        for line in ((scale, shift), (0.0, 1 / float(np.median(known_m))))
    )
    return Alignment(scale, shift, agreeing, constant)


def _agrees(x: NDArray[np.float64], known_m: NDArray[np.float64], scale: float, shift: float) -> NDArray[np.bool_]:
    inverse = scale * x + shift
    agrees: NDArray[np.bool_] = (inverse > 0) & (np.abs(np.log(inverse.clip(min=1e-9) * known_m)) < LN_AGREES)
    return agrees


def _least_squares(
    x: NDArray[np.float64], known_m: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[float, float] | None:
    """Scale and shift with the least squares of the relative error, depth (scale x + shift) - 1."""
    if len(x) < 2:
        return None
    root = np.sqrt(weight)
    system = np.stack([known_m * x, known_m], axis=1) * root[:, None]
    (scale, shift), _, rank, _ = np.linalg.lstsq(system, root, rcond=None)
    return (float(scale), float(shift)) if rank == 2 else None
