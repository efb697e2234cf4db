"""The two camera models of `[devices.lens]`: projection with derivatives, and the ray behind a pixel.

The formulas and the order of the coefficients are OpenCV's, as in `hal/src/camera_model.rs`: plumb bob is Brown (1966),
fisheye is Kannala and Brandt (2006). The centre of the first pixel is (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats

PLUMB_BOB = "plumb-bob"
FISHEYE = "fisheye"
MODELS = (PLUMB_BOB, FISHEYE)
COEFFICIENTS = {PLUMB_BOB: ("k1", "k2", "p1", "p2", "k3"), FISHEYE: ("k1", "k2", "k3", "k4")}
# Rays nearer to the optical axis than this, in radians, count as on it: the derivatives there are 0 / 0.
ON_AXIS = 1e-9
# The robot's software uses no ray further from the optical axis than this, in focal lengths (86 degrees).
WIDEST_RAY = 16.0


@dataclass(frozen=True)
class Camera:
    """A camera's intrinsics."""

    model: str
    width: int
    height: int
    values: Floats
    """fx, fy, cx, cy and the coefficients of the distortion."""

    @property
    def names(self) -> tuple[str, ...]:
        return ("fx", "fy", "cx", "cy", *COEFFICIENTS[self.model])

    @property
    def focal_px(self) -> float:
        """Mean focal length."""
        return float(self.values[:2].mean())

    def with_values(self, values: Floats) -> Camera:
        return replace(self, values=values)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the images after resampling; their outer edges are aligned, as in OpenCV's `resize`."""
        scale = np.array([width / self.width, height / self.height])
        values = self.values.copy()
        values[:2] *= scale
        values[2:4] = (values[2:4] + 0.5) * scale - 0.5
        return Camera(self.model, width, height, values)

    def project(self, points: Floats) -> Floats:
        """Pixels [n, 2] of points [n, 3] in front of the camera."""
        return self.values[:2] * distort(self.model, self.values[4:], points) + self.values[2:4]

    def project_with_derivatives(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Pixels [n, 2], their derivatives [n, 2, p] by `values` and [n, 2, 3] by the points."""
        focal = self.values[:2]
        flat, by_coefficients, by_points = _DISTORT[self.model](self.values[4:], points)
        by_values = np.zeros((len(points), 2, len(self.values)))
        by_values[:, 0, 0] = flat[:, 0]
        by_values[:, 1, 1] = flat[:, 1]
        by_values[:, 0, 2] = 1.0
        by_values[:, 1, 3] = 1.0
        by_values[:, :, 4:] = focal[:, None] * by_coefficients
        return focal * flat + self.values[2:4], by_values, focal[:, None] * by_points

    def rays(self, pixels: Floats) -> tuple[Floats, Flags]:
        """Unit vectors [n, 3] behind pixels [n, 2], and for which of them the model is valid."""
        flat = (pixels - self.values[2:4]) / self.values[:2]
        start = np.hypot(flat[:, 0], flat[:, 1])
        if self.model == FISHEYE:
            angle = np.minimum(start, 3.0)
            scale = np.where(start > ON_AXIS, np.sin(angle) / np.maximum(start, ON_AXIS), 1.0)
            rays = np.column_stack([flat * scale[:, None], np.cos(angle)])
        else:
            rays = np.column_stack([flat, np.ones(len(flat))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        rays = self._refined(rays, pixels)
        with np.errstate(all="ignore"):
            valid = np.linalg.norm(self.project(rays) - pixels, axis=1) < 1e-3
        return rays, valid & self._monotonic(rays)

    def _refined(self, rays: Floats, pixels: Floats) -> Floats:
        """Newton's method in the tangent plane of each ray. 30 steps suffice for every lens that a test has."""
        rays = rays.copy()
        moving = np.arange(len(rays))
        for _ in range(30):
            step = self._step(rays[moving], pixels[moving])
            rays[moving] += step
            rays[moving] /= np.linalg.norm(rays[moving], axis=1, keepdims=True)
            moving = moving[np.abs(step).max(axis=1, initial=0.0) > 1e-12]
            if not len(moving):
                break
        return rays

    def _step(self, rays: Floats, pixels: Floats) -> Floats:
        """By how much rays must change; nothing where the model has no inverse."""
        tangents = _tangents(rays)
        with np.errstate(all="ignore"):
            found, _, by_rays = self.project_with_derivatives(rays)
            system = by_rays @ tangents
            determinant = np.linalg.det(system)
            usable = np.isfinite(determinant) & (np.abs(determinant) > 1e-6)
            system[~usable] = np.eye(2)
            step = np.linalg.solve(system, (pixels - found)[:, :, None])
        step[~usable] = 0.0
        # A step of more than half a radian leaves the region in which the model is nearly linear.
        step *= np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
        change: Floats = (tangents @ step)[:, :, 0]
        return change

    def _monotonic(self, rays: Floats) -> Flags:
        """Whether the radial polynomial grows up to each ray. Beyond, the model shows the middle a second time."""
        angles = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
        return np.asarray(angles < self.valid_angle(), np.bool_)

    def valid_angle(self) -> float:
        """The largest angle from the optical axis, in radians, up to which the radial polynomial grows."""
        limit = np.pi if self.model == FISHEYE else np.arctan(WIDEST_RAY)
        angles = np.linspace(0.0, limit, 4000)[1:]
        slope = _radial_slope(self.model, self.values[4:], angles)
        falling = np.flatnonzero(slope <= 0.0)
        return float(angles[falling[0]]) if len(falling) else float(limit)


def distort(model: str, coefficients: Floats, points: Floats) -> Floats:
    """Image positions [n, 2] of points, in focal lengths from the optical axis."""
    return _DISTORT[model](coefficients, points)[0]


def _radial_slope(model: str, coefficients: Floats, angles: Floats) -> Floats:
    if model == FISHEYE:
        squares = angles**2
        powers = coefficients
    else:
        squares = np.tan(angles) ** 2
        powers = coefficients[[0, 1, 4]]
    slope = np.ones_like(angles)
    for index, value in enumerate(powers, 1):
        slope += (2 * index + 1) * value * squares**index
    return slope


def _tangents(rays: Floats) -> Floats:
    """Two unit vectors [n, 3, 2] that are perpendicular to each ray and to each other."""
    other = np.where(np.abs(rays[:, :1]) < 0.8, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(rays, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], axis=2)


def _plumb_bob(coefficients: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    k1, k2, p1, p2, k3 = coefficients
    # A point beside or behind the camera has no image; NaN makes the solver reject the step.
    depth = np.where(points[:, 2] > 1e-6, points[:, 2], np.nan)
    x = points[:, 0] / depth
    y = points[:, 1] / depth
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    flat = np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )
    by_coefficients = np.empty((len(points), 2, 5))
    by_coefficients[:, 0] = np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3])
    by_coefficients[:, 1] = np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3])
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
    by_flat = np.empty((len(points), 2, 2))
    by_flat[:, 0, 0] = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    by_flat[:, 0, 1] = x * y * slope + 2 * p1 * x + 2 * p2 * y
    by_flat[:, 1, 0] = by_flat[:, 0, 1]
    by_flat[:, 1, 1] = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    by_points = np.empty((len(points), 2, 3))
    by_points[:, :, :2] = by_flat / depth[:, None, None]
    by_points[:, :, 2] = -(by_flat[:, :, 0] * x[:, None] + by_flat[:, :, 1] * y[:, None]) / depth[:, None]
    return flat, by_coefficients, by_points


def _fisheye(coefficients: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    x, y, z = points.T
    r = np.maximum(np.hypot(x, y), ON_AXIS)
    angle = np.arctan2(r, z)
    a2 = angle**2
    k1, k2, k3, k4 = coefficients
    distorted = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    by_angle = 1 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4)))
    scale = distorted / r
    flat = np.column_stack([x * scale, y * scale])
    powers = np.column_stack([angle**3, angle**5, angle**7, angle**9]) / r[:, None]
    by_coefficients = points[:, :2, None] * powers[:, None, :]
    square = r * r + z * z
    # Derivatives of the scale by r, and by z at a fixed r.
    by_r = (by_angle * z / square - scale) / r
    by_z = -by_angle / square
    by_points = np.empty((len(points), 2, 3))
    by_points[:, 0, 0] = scale + by_r * x * x / r
    by_points[:, 0, 1] = by_r * x * y / r
    by_points[:, 1, 0] = by_points[:, 0, 1]
    by_points[:, 1, 1] = scale + by_r * y * y / r
    by_points[:, 0, 2] = by_z * x
    by_points[:, 1, 2] = by_z * y
    return flat, by_coefficients, by_points


_DISTORT = {PLUMB_BOB: _plumb_bob, FISHEYE: _fisheye}
