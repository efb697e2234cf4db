"""Cost volumes for networks that match images themselves (ManyDepth, Watson et al. 2021), computed as by the robot's
runtime: colours at a quarter of the size, metric poses, fixed planes of inverse depth.

Plane i of n lies at inverse depth 1/max + (1/min - 1/max) i / (n - 1). A cell is the mean, over colours and over the
earlier frames that see its point, of |this - earlier|. A plane that no earlier frame sees takes the largest cost of
its pixel. A pixel that is never seen, and every pixel without an earlier frame, has cost 0: no evidence.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.projection import Projector, bilinear_sample

REDUCTION = 4
# The runtime's choice of earlier frames: their number, the best baseline, the range of baselines and the largest
# rotation.
REFERENCES = 2
BASELINE_M = 0.15
BASELINES_M = (0.03, 0.6)
MAX_ROTATION_RAD = 0.6
# The runtime keeps eight frames 6 cm apart; frames further back than this are not searched.
WINDOW = 120
UNSEEN = -1.0


def plane_depths(planes: int, range_m: tuple[float, float]) -> Tensor:
    """Depth of the planes in metres [planes], the farthest first."""
    near, far = range_m
    return 1 / torch.linspace(1 / far, 1 / near, planes)


def references(frames: FrameSet, targets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Earlier frames that each target is matched with [B, 2], -1 where there are fewer: those whose baseline is
    closest to 15 cm."""
    found = np.full((len(targets), REFERENCES), -1, np.int64)
    for row, target in zip(found, targets, strict=True):
        window: NDArray[np.int64] = np.arange(max(0, target - WINDOW), target)
        window = window[frames.run[window] == frames.run[target]]
        here = frames.t_world_camera[target]
        there = frames.t_world_camera[window]
        baseline = np.linalg.norm(there[:, :3, 3] - here[:3, 3], axis=1)
        # Trace of R_there^T R_here.
        trace = np.einsum("nij,ij->n", there[:, :3, :3], here[:3, :3])
        rotation = np.arccos(((trace - 1) / 2).clip(-1, 1))
        fits = (baseline >= BASELINES_M[0]) & (baseline <= BASELINES_M[1]) & (rotation <= MAX_ROTATION_RAD)
        cost = np.abs(np.log(baseline[fits] / BASELINE_M)) + rotation[fits] / MAX_ROTATION_RAD
        # Of equal costs, the newest frame comes first.
        best = window[fits][::-1][np.argsort(cost[::-1], kind="stable")][:REFERENCES]
        row[: len(best)] = best
    return found


def quarter(rgb: Tensor) -> Tensor:
    """Means of 4x4 pixels of [B, 3, H, W]."""
    return F.avg_pool2d(rgb, REDUCTION)


def cost_volume(
    this: Tensor, earlier: Tensor, t_earlier_this: Tensor, exists: Tensor, projector: Projector, depths_m: Tensor
) -> Tensor:
    """The cost volume [B, planes, h, w] of `this` [B, C, h, w] against `earlier` [B, S, C, h, w], with relative poses
    `t_earlier_this` [B, S, 4, 4]; `exists` bool [B, S] is false for missing frames. `projector` has the intrinsics of
    the reduced images."""
    batch, _, height, width = this.shape
    cells = torch.full((batch, len(depths_m), height, width), UNSEEN, dtype=this.dtype, device=this.device)
    for source in range(earlier.shape[1]):
        for plane, depth_m in enumerate(depths_m):
            depth = depth_m.to(this).expand(batch, 1, height, width)
            projection = projector(depth, t_earlier_this[:, source])
            cost = (bilinear_sample(earlier[:, source], projection.u, projection.v) - this).abs().mean(1)
            cell = cells[:, plane]
            seen = projection.inside[:, 0] & exists[:, source].view(-1, 1, 1)
            cells[:, plane] = torch.where(seen, torch.where(cell < 0, cost, 0.5 * (cell + cost)), cell)
    largest = cells.amax(1, keepdim=True).clamp(min=0)
    return torch.where(cells < 0, largest, cells)


@torch.no_grad()
def volume_planes(
    frames: FrameSet,
    targets: NDArray[np.int64],
    depths_m: Tensor,
    device: torch.device | str = "cpu",
    still: NDArray[np.bool_] | None = None,
) -> Tensor:
    """The cost volume [B, planes, H / 4, W / 4] of `targets` as the robot computes it. Where `still`, it is computed
    as if nothing had moved: the earlier images are replaced by the target's, the poses stay."""
    found = references(frames, targets)
    small = frames.camera.resized((frames.camera.height // REDUCTION, frames.camera.width // REDUCTION))
    projector = Projector(small, device)
    exists = torch.from_numpy(found >= 0).to(device)
    # The target stands in for a missing reference, which is masked out.
    sources = np.where(found >= 0, found, targets[:, None])
    poses = frames.t_world_camera
    relative = (np.linalg.inv(poses[sources]) @ poses[targets][:, None]).astype(np.float32)
    if still is not None:
        sources = np.where(still[:, None], targets[:, None], sources)

    def images(index: NDArray[np.int64]) -> Tensor:
        planes = torch.from_numpy(frames.rgb[index]).to(device).movedim(-1, 1).float() / 255
        return quarter(planes)

    this = images(targets)
    earlier = torch.stack([images(sources[:, slot]) for slot in range(REFERENCES)], 1)
    # Compensates automatic exposure.
    gain = this.mean((1, 2, 3)).view(-1, 1, 1, 1, 1) / earlier.mean((2, 3, 4), keepdim=True).clamp(min=1e-6)
    return cost_volume(this, gain * earlier, torch.from_numpy(relative).to(device), exists, projector, depths_m)
