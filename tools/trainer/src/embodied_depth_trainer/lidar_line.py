"""What the safety LiDAR says about a picture: metric depth along a line, about one pixel in each column.

The scanner's plane lies below the camera, so that what it hits is seen in the lower half of the picture: the nearer,
the lower, and what is nearest of all falls out of it. It is a sensor of depth: only the loss may read it, never the
network's input and never the evaluation, and a network that was trained with it is not one that learnt from pictures
and motion alone, as the paper's do. Off unless asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from . import processes
from .frames import Intrinsics

# A scan this much older or newer than its picture shows other columns: at 20 degrees a second, 1 degree.
MAX_APART_NS = 50_000_000
# What is nearer to the camera than this is no part of a room, metres.
NEAREST_M = 0.1
# Rows and millimetres are kept in 16 bits.
LARGEST = 65535


@dataclass(frozen=True)
class Scan:
    """One turn of the scanner; the angle is 0 ahead and grows to the left."""

    time_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: NDArray[np.float64]
    """[beams]; as REP-117 has it, +inf where nothing came back, -inf where something was too near, NaN for an error."""

    @staticmethod
    def of(said: dict[str, Any], ranges: Sequence[float]) -> Scan:
        """From the recording's turn and its `foxglove.LaserScan`."""
        return Scan(
            int(said["time_ns"]),
            float(said["angle_min_rad"]),
            float(said["angle_increment_rad"]),
            float(said["range_min_m"]),
            float(said["range_max_m"]),
            np.asarray(ranges, np.float64),
        )

    def hits(self) -> NDArray[np.float64]:
        """Points [P, 3] of the scanner's frame (x ahead, y left, z up) where a beam hit something. No return is not a
        distance, and neither is an error."""
        ranges = self.ranges_m
        hit = np.isfinite(ranges) & (ranges >= self.range_min_m) & (ranges <= self.range_max_m)
        angle = (self.angle_min_rad + self.angle_increment_rad * np.arange(len(ranges)))[hit]
        return np.stack([ranges[hit] * np.cos(angle), ranges[hit] * np.sin(angle), np.zeros(len(angle))], axis=1)


def line(camera: Intrinsics, t_camera_laser: NDArray[np.float64], scan: Scan) -> NDArray[np.uint16]:
    """[2, W]: in each column the row of the pixel that shows what was hit, and its z-depth in millimetres, 0 where
    nothing is known. Of several hits in one column the nearest counts: the others may be hidden behind it."""
    x, y, z = (scan.hits() @ t_camera_laser[:3, :3].T + t_camera_laser[:3, 3]).T
    before = z > NEAREST_M
    x, y, z = x[before], y[before], z[before]
    column = np.rint(camera.fx * x / z + camera.cx).astype(np.int64)
    row = np.rint(camera.fy * y / z + camera.cy).astype(np.int64)
    millimetres = np.rint(1000 * z).astype(np.int64)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & (millimetres <= LARGEST)
    # Depth above the row in one number: the least is the nearest.
    none = np.int64(LARGEST + 1) << 16
    best = np.full(camera.width, none)
    np.minimum.at(best, column[inside], (millimetres[inside] << 16) | row[inside])
    found = best < none
    return np.where(found, np.stack([best & LARGEST, best >> 16]), 0).astype(np.uint16)


def lidar_error(depth_m: Tensor, lines: Tensor) -> Tensor:
    """Mean |ln depth - ln z| over the pixels of the lines [B, 2, W] (row, z in metres, 0: none), `depth_m`
    [B, 1, H, W] being as wide. An absolute error: some of what the scanner hits is hidden from the camera by what hangs
    above. Scalar; 0 without any hit."""
    row, z = lines.unbind(1)
    there = (z > 0).to(depth_m.dtype)
    said = depth_m[:, 0].gather(1, row.long().unsqueeze(1))[:, 0]
    error = (said.log() - torch.where(z > 0, z, 1.0).log()).abs()
    return (there * error).sum() / processes.mean(there.sum()).clamp(min=1.0)
