"""Poses in the plane, bit for bit as the robot's program computes them (`hal/src/pose.rs`)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any


def number(value: float | str) -> float:
    """A recorded number: those that are not finite are texts of their bits."""
    if isinstance(value, str):
        (found,) = struct.unpack(">d", bytes.fromhex(value))
        return float(found)
    return float(value)


@dataclass(frozen=True)
class Pose:
    """The pose of frame b in frame a is `t_a_b`."""

    x_m: float
    y_m: float
    yaw_rad: float

    @staticmethod
    def of(recorded: dict[str, Any]) -> Pose:
        return Pose(number(recorded["x_m"]), number(recorded["y_m"]), number(recorded["yaw_rad"]))

    def compose(self, t_b_c: Pose) -> Pose:
        """`t_a_b.compose(t_b_c)` is `t_a_c`, with a heading in (-pi, pi]."""
        sin, cos = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        x_m = self.x_m + cos * t_b_c.x_m - sin * t_b_c.y_m
        y_m = self.y_m + sin * t_b_c.x_m + cos * t_b_c.y_m
        return Pose(x_m, y_m, _wrapped(self.yaw_rad + t_b_c.yaw_rad))

    def is_finite(self) -> bool:
        return math.isfinite(self.x_m) and math.isfinite(self.y_m) and math.isfinite(self.yaw_rad)

    @property
    def rotation_xyzw(self) -> tuple[float, float, float, float]:
        """The heading as a unit quaternion."""
        half = self.yaw_rad / 2
        sin = math.sin(half)
        # Zeros with the sign that the robot's program gives them.
        return 0.0 * sin, 0.0 * sin, sin, math.cos(half)


IDENTITY = Pose(0.0, 0.0, 0.0)


def _wrapped(angle_rad: float) -> float:
    if not math.isfinite(angle_rad):
        return math.nan
    wrapped = angle_rad - math.tau * math.floor((angle_rad + math.pi) / math.tau)
    return wrapped + math.tau if wrapped <= -math.pi else wrapped
