"""Reference for the trainer's benchmark: one step of Monodepth2 written as the papers' formulas, one PyTorch operator
after another.

It is not slow on purpose. It is a straightforward implementation: float32, `F.grid_sample`, SSIM with `AvgPool2d`,
every source separately, Adam with its defaults. The trainer's tests prove that both compute the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class Ssim(nn.Module):
    """(1 - SSIM) / 2 of 3x3 patches (Godard et al. 2019)."""

    def __init__(self) -> None:
        super().__init__()
        self.pad = nn.ReflectionPad2d(1)
        self.mean = nn.AvgPool2d(3, 1)

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        x = self.pad(x)
        y = self.pad(y)
        mu_x = self.mean(x)
        mu_y = self.mean(y)
        sigma_x = self.mean(x**2) - mu_x**2
        sigma_y = self.mean(y**2) - mu_y**2
        sigma_xy = self.mean(x * y) - mu_x * mu_y
        numerator = (2 * mu_x * mu_y + 0.01**2) * (2 * sigma_xy + 0.03**2)
        denominator = (mu_x**2 + mu_y**2 + 0.01**2) * (sigma_x + sigma_y + 0.03**2)
        return torch.clamp((1 - numerator / denominator) / 2, 0, 1)


class Warp(nn.Module):
    """Back-projects depth to points, projects them into the source and samples its colours."""

    def __init__(self, height: int, width: int, k: Tensor) -> None:
        super().__init__()
        self.height = height
        self.width = width
        self.k = k
        self.inverse_k = torch.linalg.inv(k)
        v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        self.pixels = torch.stack([u.flatten(), v.flatten(), torch.ones(height * width)]).float().to(k.device)

    def forward(self, image: Tensor, depth_m: Tensor, t_source_target: Tensor) -> tuple[Tensor, Tensor]:
        """The warped image, and a mask of the pixels that lie within the source."""
        points = (self.inverse_k @ self.pixels) * depth_m.flatten(2)
        points = t_source_target[:, :3, :3] @ points + t_source_target[:, :3, 3:]
        projected = self.k @ points
        z = projected[:, 2]
        u = projected[:, 0] / z.clamp(min=1e-3)
        v = projected[:, 1] / z.clamp(min=1e-3)
        right = self.width - 1 + 1e-3
        bottom = self.height - 1 + 1e-3
        inside = (z > 1e-3) & (u >= -1e-3) & (u <= right) & (v >= -1e-3) & (v <= bottom)
        grid = torch.stack([2 * u / (self.width - 1) - 1, 2 * v / (self.height - 1) - 1], -1)
        grid = grid.view(-1, self.height, self.width, 2)
        warped = F.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=True)
        return warped, inside.view(-1, 1, self.height, self.width)


def smoothness(disparity: Tensor, image: Tensor) -> Tensor:
    normal = disparity / (disparity.mean((2, 3), keepdim=True) + 1e-7)
    across = torch.abs(normal[:, :, :, :-1] - normal[:, :, :, 1:])
    down = torch.abs(normal[:, :, :-1, :] - normal[:, :, 1:, :])
    edge_across = torch.mean(torch.abs(image[:, :, :, :-1] - image[:, :, :, 1:]), 1, keepdim=True)
    edge_down = torch.mean(torch.abs(image[:, :, :-1, :] - image[:, :, 1:, :]), 1, keepdim=True)
    return (across * torch.exp(-edge_across)).mean() + (down * torch.exp(-edge_down)).mean()


class TextbookLoss(nn.Module):
    """0.85 (1 - SSIM) / 2 + 0.15 L1 of the best source of every pixel that some source sees, and 0.001 smoothness."""

    def __init__(self, height: int, width: int, k: Tensor) -> None:
        super().__init__()
        self.warp = Warp(height, width, k)
        self.ssim = Ssim()

    def forward(self, depth_m: Tensor, image: Tensor, sources: Sequence[Tensor], poses: Sequence[Tensor]) -> Tensor:
        errors = []
        for source, pose in zip(sources, poses, strict=True):
            warped, inside = self.warp(source, depth_m, pose)
            l1 = torch.abs(image - warped).mean(1, True)
            error = 0.85 * self.ssim(image, warped).mean(1, True) + 0.15 * l1
            errors.append(torch.where(inside, error, torch.full_like(error, float("inf"))))
        best = torch.cat(errors, 1).min(1, keepdim=True).values
        valid = torch.isfinite(best)
        return best[valid].mean() + 1e-3 * smoothness(1 / depth_m, image)
