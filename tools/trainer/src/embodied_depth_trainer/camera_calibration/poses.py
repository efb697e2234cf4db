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
    found: Floats = np.eye(3) + first * crossed + second * (crossed @ crossed)
    return found


def cross_matrices(vectors: Floats) -> Floats:
    """Matrices [n, 3, 3] that compute the cross product with each vector."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def guess_poses(points_mm: Floats, rays: Floats, view: Indices) -> Poses:
    """Poses of a flat board whose corners lie on the rays, for all views at once; `view` [n] increases.

    The homography H from the board's plane to rays is the null space of ray x H p = 0 (the direct linear transform),
    which also holds for rays 90 degrees and more from the optical axis. The rotation is the nearest to H's first two
    columns and their cross product (Zhang 2000).
    """
    starts = np.unique(view, return_index=True)[1]
    counts = np.diff(np.append(starts, len(view)))[:, None]
    centre = np.add.reduceat(points_mm[:, :2], starts, axis=0) / counts
    # With coordinates of about 1 the equations are well conditioned.
    shifted = points_mm[:, :2] - centre[view]
    scale = np.maximum(np.maximum.reduceat(np.abs(shifted).max(axis=1), starts), 1e-9)
    flat = np.column_stack([shifted / scale[view, None], np.ones(len(view))])
    equations = (cross_matrices(rays)[:, :, :, None] * flat[:, None, None, :]).reshape(-1, 3, 9)
    products = np.add.reduceat(equations.transpose(0, 2, 1) @ equations, starts, axis=0)
    matrices = np.linalg.eigh(products)[1][:, :, 0].reshape(-1, 3, 3)
    # The corners lie on the rays and not on their opposite.
    along = np.add.reduceat(np.einsum("ni,nij,nj->n", rays, matrices[view], flat), starts)
    matrices = matrices * np.where(along < 0, -1.0, 1.0)[:, None, None]
    length = np.linalg.norm(matrices[:, :, :2], axis=1).mean(axis=1)
    matrices = matrices / np.maximum(length, 1e-12)[:, None, None]
    columns = np.cross(matrices[:, :, 0], matrices[:, :, 1])[:, :, None]
    left, _, right = np.linalg.svd(np.concatenate([matrices[:, :, :2], columns], axis=2))
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    rotation = left @ right
    return Poses(rotation, matrices[:, :, 2] * scale[:, None] - np.einsum("vij,vj->vi", rotation[:, :, :2], centre))
