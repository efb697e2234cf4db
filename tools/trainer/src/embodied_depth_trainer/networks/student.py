"""The small depth network that runs on the robot's CPU.

Like EDN it takes an image and coarse depth, and refines the latter. Holes of the coarse depth are first filled from
their surroundings without learnt parameters. The network learns by which factor the filled depth is wrong, by which
factor valid coarse depth is wrong, and how far to trust it. Untrained, it predicts the filled coarse depth.

Coarse depth comes from cells of 4x4 pixels, so everything is computed at a quarter of the size; the detail that the
image's edges added to the coarse depth is restored at full size. The network uses only operations that every runtime
has: convolutions, pooling, resizing by 2, reordering, and a few pixel-wise functions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

# Channels at 1/2, 1/4, ... 1/32 of the size; multiples of 16 suit vector units.
WIDTHS = (16, 32, 64, 128, 192)
# Blocks at 1/8, 1/16 and 1/32 of the size: depth without coarse depth needs the context of the whole image, which is
# cheap at low resolution.
BLOCKS = (2, 3, 4)
# Pixels along a side of a cell of coarse depth.
CELL = 4
# Depth that an untrained network predicts where there is no coarse depth at all, metres: typical for a room.
DEFAULT_DEPTH_M = 2.5
# Confidence of a cell at which its own depth counts as much as its surroundings, as a share of full confidence.
FILL_CONFIDENCE = 0.01
# Largest factor by which valid coarse depth is corrected, and largest factor for filled depth.
LARGEST_FACTOR = 1.5
LARGEST_FILL_FACTOR = 8.0
# Limits of the Laplace scale of the error of ln depth. An untrained network predicts 0.2, at which depth is correct
# within 25 % with a probability of 67 %, too low for the map.
SCALES = (0.01, 2.0)
INITIAL_SCALE = 0.2
# Least scale in inference where there is no coarse depth: correct with a probability of 75 %, too low for the map,
# because one wrong wall that no motion has confirmed blocks a door. Training is not affected.
UNCONFIRMED_SCALE = 0.16
# Trust of an untrained network in valid coarse depth: sigmoid(4) = 0.98.
GATE_BIAS = 4.0


def _block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Depthwise 3x3, then pointwise. Export folds the batch norms into the convolutions."""
    return nn.Sequential(
        nn.Conv2d(inputs, inputs, 3, stride, 1, groups=inputs, bias=False),
        nn.BatchNorm2d(inputs),
        nn.ReLU(inplace=True),
        nn.Conv2d(inputs, outputs, 1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.block = _block(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = x + self.block(x)
        return y


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")


def fill(disparity: Tensor, weight: Tensor, default: float) -> Tensor:
    """Fills disparity [N, 1, h, w], h and w multiples of 8: it stays where `weight` in 0..1 is high, becomes the
    weighted mean of increasingly large surroundings where it is low, and `default` where nothing is known (pull-push,
    Gortler et al. 1996, The Lumigraph)."""
    levels = [(disparity * weight, weight)]
    for _ in range(3):
        levels.append(tuple(F.avg_pool2d(plane, 2) for plane in levels[-1]))  # type: ignore[arg-type]
    total, sum_of_weights = (plane.mean((2, 3), keepdim=True) for plane in levels[-1])
    tiny = FILL_CONFIDENCE**2
    known = (total + tiny * default) / (sum_of_weights + tiny)
    for step, (total, sum_of_weights) in enumerate(reversed(levels)):
        if step:
            # Smoother than nearest-neighbour upsampling alone.
            known = F.avg_pool2d(_double(known), 3, 1, 1, count_include_pad=False)
        known = (total + FILL_CONFIDENCE * known) / (sum_of_weights + FILL_CONFIDENCE)
    return known


class Student(nn.Module):
    """Maps `rgb` [N, 3, H, W] in 0..1 and `coarse` [N, 3, H, W] (disparity in 0..1 over the depth range, validity,
    confidence) to [N, 2, H, W]: disparity in 0..1, and ln b with b the Laplace scale of the error of ln depth. H and W
    are multiples of 32."""

    def __init__(self, depth_range_m: tuple[float, float] = (0.1, 20.0), widths: Sequence[int] = WIDTHS) -> None:
        super().__init__()
        near, far = depth_range_m
        self.farthest = 1 / far
        self.span = 1 / near - 1 / far
        self.default_disparity = 1 / min(max(DEFAULT_DEPTH_M, 1.01 * near), 0.99 * far)
        half = widths[0]
        quarter = widths[1]
        self.stem = nn.Sequential(nn.Conv2d(3, half, 3, 2, 1, bias=False), nn.BatchNorm2d(half), nn.ReLU(inplace=True))
        # Checkpoints and exported models contain this name.
        self.picture = _block(half, quarter, 2)
        # Joined with ln of the filled disparity, validity, confidence and the row: the floor is in the lower rows.
        self.join = _block(quarter + 4, quarter)
        self.down = nn.ModuleList(
            nn.Sequential(_block(fine, wide, 2), *(_Residual(wide) for _ in range(count - 1)))
            for (fine, wide), count in zip(pairwise(widths[1:]), BLOCKS, strict=True)
        )
        self.up = nn.ModuleList(_block(wide + fine, fine) for fine, wide in reversed(list(pairwise(widths[1:]))))
        self.head = nn.Conv2d(quarter, 4, 1)
        nn.init.normal_(self.head.weight, std=1e-3)
        self.scale_low = math.log(SCALES[0])
        self.scale_high = math.log(SCALES[1])
        initial = (math.log(INITIAL_SCALE) - self.scale_low) / (self.scale_high - self.scale_low)
        self.head.bias = nn.Parameter(torch.tensor([0.0, GATE_BIAS, 0.0, math.log(initial / (1 - initial))]))
        self.register_buffer("upsampling", _bilinear(4), persistent=False)

    upsampling: Tensor

    def forward(self, rgb: Tensor, coarse: Tensor) -> Tensor:
        validity = coarse[:, 1:2]
        # 1 / metres; 0 where coarse depth is missing.
        disparity = validity * self.farthest + self.span * coarse[:, :1]
        weight = coarse[:, 2:3]
        cells = F.avg_pool2d(torch.cat([disparity * weight, validity, weight], 1), CELL)
        total, share, confidence = cells.chunk(3, 1)
        filled = fill(total / confidence.clamp(min=1e-6), confidence, self.default_disparity)
        factor, gate, fill_factor, scale = self._learnt(rgb, filled, share, confidence).chunk(4, 1)
        trust = torch.sigmoid(gate)
        corrected = trust * torch.exp(math.log(LARGEST_FACTOR) * torch.tanh(factor))
        refilled = filled * torch.exp(math.log(LARGEST_FILL_FACTOR) * torch.tanh(fill_factor))
        scale = self.scale_low + (self.scale_high - self.scale_low) * torch.sigmoid(scale)
        if not self.training:
            unconfirmed = math.log(UNCONFIRMED_SCALE) - self.scale_low
            scale = torch.maximum(scale, self.scale_low + unconfirmed * (1 - share))
        maps = _upsample(torch.cat([corrected, trust, refilled, scale], 1), self.upsampling)
        corrected, trust, refilled, scale = maps.chunk(4, 1)
        predicted = corrected * disparity + (1 - trust * validity) * refilled
        return torch.cat([((predicted - self.farthest) / self.span).clamp(0.0, 1.0), scale], 1)

    def _learnt(self, rgb: Tensor, filled: Tensor, share: Tensor, confidence: Tensor) -> Tensor:
        """The learnt maps [N, 4, H / 4, W / 4] before their limits are applied: ln factor and trust of coarse depth,
        ln factor of filled depth, ln scale."""
        rows = torch.linspace(-1, 1, filled.shape[2], device=filled.device).view(1, 1, -1, 1).expand_as(filled)
        known = torch.cat([torch.log(filled), share, confidence, rows], 1)
        x = self.join(torch.cat([self.picture(self.stem(rgb * 2 - 1)), known], 1))
        pyramid = [x]
        for down in self.down:
            x = down(x)
            pyramid.append(x)
        for up, skip in zip(self.up, reversed(pyramid[:-1]), strict=True):
            x = up(torch.cat([_double(x), skip], 1))
        # In float32 also under autocast: bfloat16 has steps of 0.4 %, which the exponentials would multiply.
        with torch.autocast(x.device.type, enabled=False):
            predicted: Tensor = self.head(_single(x))
        return predicted


def _bilinear(channels: int) -> Tensor:
    """Weights that interpolate each of the `CELL`^2 pixels of a cell from the 3x3 cells around it, [channels CELL^2,
    1, 3, 3]. A convolution and a reordering take a third of the time of a runtime's own resizing."""
    offset = (torch.arange(CELL) + 0.5) / CELL - 0.5
    line = torch.stack([(-offset).clamp(min=0), 1 - offset.abs(), offset.clamp(min=0)], 1)
    return torch.einsum("ai,bj->abij", line, line).reshape(CELL * CELL, 1, 3, 3).repeat(channels, 1, 1, 1)


def _upsample(maps: Tensor, weights: Tensor) -> Tensor:
    """Bilinear upsampling from [N, C, h, w] to [N, C, CELL h, CELL w] with a replicated border."""
    # F.pad is avoided because some runtimes pad with zeros only.
    padded = torch.cat([maps[:, :, :1], maps, maps[:, :, -1:]], 2)
    padded = torch.cat([padded[..., :1], padded, padded[..., -1:]], 3)
    # In float32 also under autocast, because these are depths and not features.
    with torch.autocast(maps.device.type, enabled=False):
        return F.pixel_shuffle(F.conv2d(padded, weights, groups=maps.shape[1]), CELL)


def _single(x: Tensor) -> Tensor:
    """`x` in float32; nothing is added to the graph if it is already."""
    return x if x.dtype == torch.float32 else x.float()
