"""Projects depth from one camera into another and samples its image there.

Pixel centres are at integer coordinates, and all coordinates are in pixels. Sampling half a pixel off, as
`F.grid_sample` does by default in this convention, biases depth by several percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from embodied_depth_trainer.data.frames import Intrinsics

# Points nearer to the source camera than this count as behind it, metres.
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
    """`t_source_target` [..., 4, 4]: transforms points from the target's camera to the source's."""
    return invert_rigid(t_world_source) @ t_world_target


def bilinear_sample(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Samples `image` [B, C, H, W] at columns `u` and rows `v` [B, H, W], which must lie inside; differentiable by all
    three.

    PyTorch's fused sampler takes less than half the time of four gathers. With `align_corners` its -1 and 1 are the
    centres of the first and the last pixel, which is the convention here; without, they are the outer edges.
    """
    height, width = image.shape[-2:]
    grid = torch.stack([u * (2 / (width - 1)) - 1, v * (2 / (height - 1)) - 1], dim=-1)
    return F.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=True)


@dataclass(frozen=True)
class Projection:
    """The target's pixels in the source image."""

    u: Tensor
    """Column [B, H, W], clamped to the image."""
    v: Tensor
    """Row [B, H, W], clamped to the image."""
    depth_m: Tensor
    """z-depth in the source camera [B, 1, H, W]."""
    inside: Tensor
    """bool [B, 1, H, W]: in front of the source camera and within its image."""

    def sample(self, image: Tensor) -> Tensor:
        """The source's image [B, C, H, W] warped into the target's view."""
        return bilinear_sample(image, self.u, self.v)


class Projector:
    """Projects depth maps of a camera into other views of the same camera."""

    def __init__(self, camera: Intrinsics, device: torch.device | str = "cpu") -> None:
        self.camera = camera
        self.k = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], device=device)
        rows, columns = torch.meshgrid(
            torch.arange(camera.height, device=device, dtype=torch.float32),
            torch.arange(camera.width, device=device, dtype=torch.float32),
            indexing="ij",
        )
        x = (columns - camera.cx) / camera.fx
        y = (rows - camera.cy) / camera.fy
        # Rays K^-1 (u, v, 1), [3, H W].
        self.rays = torch.stack([x, y, torch.ones_like(x)]).view(3, -1)

    def __call__(self, depth_m: Tensor, t_source_target: Tensor, left: int = 0) -> Projection:
        """Projects `depth_m` [B, 1, H, w], z-depth in the target camera from column `left` on, by `t_source_target`
        [B, 4, 4]."""
        batch, _, rows, columns = depth_m.shape
        height = self.camera.height
        width = self.camera.width
        # K R K^-1 (u, v, 1) is computed once per batch; depth only scales it.
        pixel_rays = self.rays.view(3, height, width)[:, :rows, left : left + columns].reshape(3, -1)
        rays = (self.k @ t_source_target[:, :3, :3]) @ pixel_rays
        shift = (self.k @ t_source_target[:, :3, 3:]).view(batch, 3, 1, 1)
        u, v, z = _Project.apply(depth_m, rays.view(batch, 3, rows, columns), shift)
        with torch.no_grad():
            # A rounding error of a thousandth of a pixel must not mask the border when the camera did not move.
            slack = 1e-3
            inside = (
                (z > NEAREST_M) & (u >= -slack) & (u <= width - 1 + slack) & (v >= -slack) & (v <= height - 1 + slack)
            )
        # PyTorch's sampler reads outside of the image at NaN. NaN stays in the depth, where the loss detects it.
        u = u.nan_to_num(0.0).clamp(0, width - 1)
        v = v.nan_to_num(0.0).clamp(0, height - 1)
        return Projection(u, v, z.unsqueeze(1), inside.unsqueeze(1))


class _Project(torch.autograd.Function):
    """Pixel coordinates and depth [B, H, W] of the points `shift` + `rays` times depth. The gradient by the depth is
    written out: du/dz = (ray_u - u ray_z) / z in the source camera. The pose needs no gradient."""

    @staticmethod
    def forward(ctx: Any, depth_m: Tensor, rays: Tensor, shift: Tensor) -> tuple[Tensor, Tensor, Tensor]:  # noqa: ANN401
        x, y, z = torch.addcmul(shift, rays, depth_m).unbind(1)
        inverse = z.clamp(min=NEAREST_M).reciprocal_()
        u = x * inverse
        v = y * inverse
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
