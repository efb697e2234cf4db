"""The safety LiDAR's scan in an image: metric depth along a line, about one pixel in each column.

The scanner's plane lies below the camera, so its hits appear in the lower half of the image: the nearer, the lower,
and the nearest fall below the image. The LiDAR is a depth sensor. Only the loss may read it, never the network's input
and never the evaluation, and a network trained with it did not learn from images and motion alone as the paper's do.
It is off unless requested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Intrinsics

# Limits of the time between the middle of a scan and a frame. It may be two revolutions, because the newest whole scan
# of a scanner of 10 revolutions a second has its middle up to 150 ms before a frame. The robot's own motion is taken
# out.
APART_NS = (50_000_000, 250_000_000)
# Hits nearer to the camera than this are not part of the scene, metres.
NEAREST_M = 0.1
# Rows and millimetres are stored in 16 bits.
LARGEST = 65535


@dataclass(frozen=True)
class Scan:
    """One scan; the angle is 0 ahead and grows to the left."""

    time_ns: int
    angle_min_rad: float
    angle_increment_rad: float
    range_min_m: float
    range_max_m: float
    period_ns: int
    ranges_m: NDArray[np.float64]
    """[beams]; as in REP-117, +inf is no return, -inf a hit that was too near, NaN an error."""

    @staticmethod
    def of(entry: dict[str, Any], ranges: Sequence[float]) -> Scan:
        """From the scan's entry in the recorded tick and its `foxglove.LaserScan`."""
        return Scan(
            int(entry["time_ns"]),
            float(entry["angle_min_rad"]),
            float(entry["angle_increment_rad"]),
            float(entry["range_min_m"]),
            float(entry["range_max_m"]),
            int(entry["period_ns"]),
            np.asarray(ranges, np.float64),
        )

    def belongs_to(self, frame_ns: int) -> bool:
        """Whether it is near enough in time to a frame."""
        middle_ns = self.time_ns + self.period_ns // 2
        shortest_ns, longest_ns = APART_NS
        return abs(middle_ns - frame_ns) <= min(max(2 * self.period_ns, shortest_ns), longest_ns)

    def hits(self) -> NDArray[np.float64]:
        """Points [P, 3] in the scanner's frame (x ahead, y left, z up) where a beam hit something. Beams without a
        return and errors give no point."""
        ranges = self.ranges_m
        hit = np.isfinite(ranges) & (ranges >= self.range_min_m) & (ranges <= self.range_max_m)
        angle = (self.angle_min_rad + self.angle_increment_rad * np.arange(len(ranges)))[hit]
        return np.stack([ranges[hit] * np.cos(angle), ranges[hit] * np.sin(angle), np.zeros(len(angle))], axis=1)


def line(camera: Intrinsics, t_camera_laser: NDArray[np.float64], scan: Scan) -> NDArray[np.uint16]:
    """[2, W]: for each column the row of the pixel that shows the hit, and its z-depth in millimetres, 0 where nothing
    is known. Of several hits in one column the nearest counts: it may occlude the others."""
    x, y, z = (scan.hits() @ t_camera_laser[:3, :3].T + t_camera_laser[:3, 3]).T
    in_front = z > NEAREST_M
    x = x[in_front]
    y = y[in_front]
    z = z[in_front]
    column = np.rint(camera.fx * x / z + camera.cx).astype(np.int64)
    row = np.rint(camera.fy * y / z + camera.cy).astype(np.int64)
    millimetres = np.rint(1000 * z).astype(np.int64)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & (millimetres <= LARGEST)
    # Depth in the upper and the row in the lower 16 bits of one number: the least number is the nearest hit.
    none = np.int64(LARGEST + 1) << 16
    best = np.full(camera.width, none)
    np.minimum.at(best, column[inside], (millimetres[inside] << 16) | row[inside])
    found = best < none
    return np.where(found, np.stack([best & LARGEST, best >> 16]), 0).astype(np.uint16)
