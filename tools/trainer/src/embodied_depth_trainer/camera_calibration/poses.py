"""Poses of a flat board in the camera: rotations, and a first guess from rays through its corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats, Indices


@dataclass(frozen=True)
class Poses:
    """`t_camera_board` of every view."""

    rotation: Floats
    """[v, 3, 3]"""
    translation_mm: Floats
    """[v, 3]"""

    def of_views(self, chosen: Indices) -> Poses:
        return Poses(self.rotation[chosen], self.translation_mm[chosen])

    def moved(self, step: Floats) -> Poses:
        """Poses after small rotations (on the camera's side) and translations, [v, 6]."""
        return Poses(rotations(step[:, :3]) @ self.rotation, self.translation_mm + step[:, 3:])

    def normals(self) -> Floats:
        """The board's normal in the camera [v, 3]."""
        normals: Floats = self.rotation[:, :, 2]
        return normals


def rotations(vectors: Floats) -> Floats:
    """Rotations [n, 3, 3] by the angle and about the axis of each vector (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    # sin(a)/a and (1 - cos a)/a^2, both without division by zero.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    crossed = cross_matrices(vectors)
    return np.eye(3) + first * crossed + second * (crossed @ crossed)


def cross_matrices(vectors: Floats) -> Floats:
    """Matrices [n, 3, 3] that compute the cross product with each vector."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def guess_pose(points_mm: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Rotation and translation of a flat board whose corners lie on the rays.

    The homography H from the board's plane to rays is the null space of ray x H p = 0 (the direct linear transform),
    which also holds for rays 90 degrees and more from the optical axis. The rotation is the nearest to H's first two
    columns and their cross product (Zhang 2000).
    """
    centre = points_mm[:, :2].mean(axis=0)
    # With coordinates of about 1 the equations are well conditioned.
    scale = max(float(np.abs(points_mm[:, :2] - centre).max()), 1e-9)
    flat = np.column_stack([(points_mm[:, :2] - centre) / scale, np.ones(len(points_mm))])
    equations = (cross_matrices(rays)[:, :, :, None] * flat[:, None, None, :]).reshape(-1, 9)
    matrix = np.linalg.eigh(equations.T @ equations)[1][:, 0].reshape(3, 3)
    # The corners lie on the rays and not on their opposite.
    if np.sum(rays * (flat @ matrix.T)) < 0:
        matrix = -matrix
    length = np.linalg.norm(matrix[:, :2], axis=0).mean()
    first, second, origin = (matrix / max(float(length), 1e-12)).T
    left, _, right = np.linalg.svd(np.column_stack([first, second, np.cross(first, second)]))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rotation, origin * scale - rotation[:, :2] @ centre
