"""One camera's picture as another camera would see it, by depth and relative pose.

Pixel centres are at integer coordinates, and everything here speaks of pixels. Sampling half a pixel off, as
`F.grid_sample` does with its defaults in this convention, biases depth by several percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from .frames import Intrinsics

# What is nearer to the source camera than this is behind it for our purposes, metres.
NEAREST_M = 1e-3


def invert_rigid(pose: Tensor) -> Tensor:
    """Inverse of rigid poses [..., 4, 4]."""
    rotation = pose[..., :3, :3].transpose(-1, -2)
    inverse = torch.zeros_like(pose)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3:] = -rotation @ pose[..., :3, 3:]
    inverse[..., 3, 3] = 1.0
    return inverse


def relative_pose(t_world_source: Tensor, t_world_target: Tensor) -> Tensor:
    """`t_source_target` [..., 4, 4]: brings points of the target's camera into the source's."""
    return invert_rigid(t_world_source) @ t_world_target


def bilinear_sample(picture: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """`picture` [B, C, H, W] at columns `u` and rows `v` [B, H, W], which must lie inside; differentiable by all three.

    PyTorch's fused sampler takes less than half the time of four gathers. With `align_corners` its -1 and 1 are the
    centres of the first and the last pixel, which is our convention; without, they are the outer edges.
    """
    height, width = picture.shape[-2:]
    grid = torch.stack([u * (2 / (width - 1)) - 1, v * (2 / (height - 1)) - 1], dim=-1)
    return F.grid_sample(picture, grid, mode="bilinear", padding_mode="border", align_corners=True)


@dataclass(frozen=True)
class Projection:
    """Where the target's pixels are in the source picture."""

    u: Tensor
    """Column [B, H, W], inside the picture."""
    v: Tensor
    """Row [B, H, W], inside the picture."""
    depth_m: Tensor
    """z-depth in the source camera [B, 1, H, W]."""
    inside: Tensor
    """bool [B, 1, H, W]: in front of the source camera and within its picture."""

    def sample(self, picture: Tensor) -> Tensor:
        """The source's picture [B, C, H, W] as the target sees it."""
        return bilinear_sample(picture, self.u, self.v)


class Projector:
    """Projects depth maps of one camera into earlier and later views of the same camera."""

    def __init__(self, camera: Intrinsics, device: torch.device | str = "cpu") -> None:
        self.camera = camera
        self.k = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], device=device)
        rows, columns = torch.meshgrid(
            torch.arange(camera.height, device=device, dtype=torch.float32),
            torch.arange(camera.width, device=device, dtype=torch.float32),
            indexing="ij",
        )
        x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
        # [3, H W]: K^-1 (u, v, 1).
        self.rays = torch.stack([x, y, torch.ones_like(x)]).view(3, -1)

    def __call__(self, depth_m: Tensor, t_source_target: Tensor, left: int = 0) -> Projection:
        """Of `depth_m` [B, 1, H, w], z-depth in the target camera from column `left` on, by `t_source_target`
        [B, 4, 4]."""
        batch, _, rows, columns = depth_m.shape
        height, width = self.camera.height, self.camera.width
        # K R K^-1 (u, v, 1) once a batch; the depth then only scales it.
        seen = self.rays.view(3, height, width)[:, :rows, left : left + columns].reshape(3, -1)
        rays = (self.k @ t_source_target[:, :3, :3]) @ seen
        shift = (self.k @ t_source_target[:, :3, 3:]).view(batch, 3, 1, 1)
        u, v, z = _Project.apply(depth_m, rays.view(batch, 3, rows, columns), shift)
        with torch.no_grad():
            # A thousandth of a pixel of rounding must not blank the border of an unmoved picture.
            slack = 1e-3
            inside = (
                (z > NEAREST_M) & (u >= -slack) & (u <= width - 1 + slack) & (v >= -slack) & (v <= height - 1 + slack)
            )
        # PyTorch's sampler reads outside of the picture at NaN. NaN stays in the depth, where the loss finds it.
        u, v = u.nan_to_num(0.0).clamp(0, width - 1), v.nan_to_num(0.0).clamp(0, height - 1)
        return Projection(u, v, z.unsqueeze(1), inside.unsqueeze(1))


class _Project(torch.autograd.Function):
    """Pixel coordinates and depth [B, H, W] of the points `shift` + `rays` times depth, with the gradient by the depth
    written down: du/dz = (ray_u - u ray_z) / z in the source camera, and nobody asks for the pose's."""

    @staticmethod
    def forward(ctx: Any, depth_m: Tensor, rays: Tensor, shift: Tensor) -> tuple[Tensor, Tensor, Tensor]:  # noqa: ANN401
        x, y, z = torch.addcmul(shift, rays, depth_m).unbind(1)
        inverse = z.clamp(min=NEAREST_M).reciprocal_()
        u, v = x * inverse, y * inverse
        ctx.save_for_backward(rays, u, v, z, inverse)
        return u, v, z

    @staticmethod
    def backward(ctx: Any, by_u: Tensor, by_v: Tensor, by_z: Tensor) -> tuple[Tensor, None, None]:  # noqa: ANN401
        rays, u, v, z, inverse = ctx.saved_tensors
        ray_u, ray_v, ray_z = rays.unbind(1)
        in_front = (z > NEAREST_M).to(z.dtype)
        by_inverse = (by_u * u).addcmul_(by_v, v).mul_(in_front).mul_(ray_z)
        by_depth = (by_u * ray_u).addcmul_(by_v, ray_v).sub_(by_inverse).mul_(inverse).addcmul_(by_z, ray_z)
        return by_depth.unsqueeze(1), None, None
