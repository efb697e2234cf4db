"""The small depth network that runs on the robot's CPU.

It takes what EDN takes, a picture and coarse depth, and refines. Holes of the coarse depth are first filled from what
surrounds them, with nothing to learn: by which factor that is wrong, by which factor coarse depth is wrong where it is
valid, and how far to believe it there, is what is learnt. Untrained, it says the filled coarse depth.

Coarse depth comes from cells of 4x4 pixels, so that everything is computed at a quarter of the size; what the picture's
edges added to the coarse depth comes back at full size. Only operations that every runtime has: convolutions, pooling,
resizing by 2, reordering, and a few functions of one pixel.
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
# Blocks at 1/8, 1/16 and 1/32 of the size: depth without coarse depth needs a picture's whole context, and is cheap to
# look for from afar.
BLOCKS = (2, 3, 4)
# Pixels along a side of a cell of coarse depth.
CELL = 4
# Depth that an untrained network says where there is no coarse depth at all: the middle of a room, metres.
USUAL_DEPTH_M = 2.5
# How much a cell must know to be believed beside what its surroundings say, as a share of full confidence.
FILL_SHARE = 0.01
# Coarse depth is corrected in place by at most this factor, filled depth by at most this one.
LARGEST_FACTOR, LARGEST_FILL_FACTOR = 1.5, 8.0
# The Laplace scale of the error of ln depth lies between these. An untrained network is unsure: at 0.2, a depth is
# right within 25 % with a probability of 67 %, too little for the map.
SCALES = (0.01, 2.0)
USUAL_SCALE = 0.2
# Where there is no coarse depth, it says no smaller scale than this in use: right with a probability of 75 %, too
# little for the map. One wrong wall that no motion has confirmed closes a door. What it learns is not touched by it.
UNCONFIRMED_SCALE = 0.16
# How far an untrained network believes valid coarse depth: sigmoid(4) = 0.98.
GATE_BIAS = 4.0


def _block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Depthwise 3x3, then pointwise. Batch norms become part of the convolutions at export."""
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


def fill(disparity: Tensor, weight: Tensor, usual: float) -> Tensor:
    """Disparity [N, 1, h, w] everywhere, h and w multiples of 8: known ones where `weight` in 0..1 is high, the
    weighted mean of ever larger surroundings where it is low, and `usual` where nothing is known (pull-push, Gortler et
    al. 1996, The Lumigraph)."""
    levels = [(disparity * weight, weight)]
    for _ in range(3):
        levels.append(tuple(F.avg_pool2d(plane, 2) for plane in levels[-1]))  # type: ignore[arg-type]
    total, sum_of_weights = (plane.mean((2, 3), keepdim=True) for plane in levels[-1])
    tiny = FILL_SHARE**2
    known = (total + tiny * usual) / (sum_of_weights + tiny)
    for step, (total, sum_of_weights) in enumerate(reversed(levels)):
        if step:
            # Rounder than the nearest neighbour alone.
            known = F.avg_pool2d(_double(known), 3, 1, 1, count_include_pad=False)
        known = (total + FILL_SHARE * known) / (sum_of_weights + FILL_SHARE)
    return known


class Student(nn.Module):
    """`rgb` [N, 3, H, W] in 0..1 and `coarse` [N, 3, H, W] (disparity in 0..1 over the depth range, validity,
    confidence) to [N, 2, H, W]: disparity in 0..1, and ln b with b the Laplace scale of the error of ln depth. H and W
    are multiples of 32."""

    def __init__(self, depth_range_m: tuple[float, float] = (0.1, 20.0), widths: Sequence[int] = WIDTHS) -> None:
        super().__init__()
        near, far = depth_range_m
        self.farthest, self.span = 1 / far, 1 / near - 1 / far
        usual = min(max(USUAL_DEPTH_M, 1.01 * near), 0.99 * far)
        self.usual = 1 / usual
        half, quarter = widths[0], widths[1]
        self.stem = nn.Sequential(nn.Conv2d(3, half, 3, 2, 1, bias=False), nn.BatchNorm2d(half), nn.ReLU(inplace=True))
        self.picture = _block(half, quarter, 2)
        # With ln of the filled disparity, validity, confidence and the height in the picture: the floor lies low.
        self.join = _block(quarter + 4, quarter)
        self.down = nn.ModuleList(
            nn.Sequential(_block(fine, wide, 2), *(_Residual(wide) for _ in range(count - 1)))
            for (fine, wide), count in zip(pairwise(widths[1:]), BLOCKS, strict=True)
        )
        self.up = nn.ModuleList(_block(wide + fine, fine) for fine, wide in reversed(list(pairwise(widths[1:]))))
        self.head = nn.Conv2d(quarter, 4, 1)
        nn.init.normal_(self.head.weight, std=1e-3)
        self.scale_low, self.scale_high = math.log(SCALES[0]), math.log(SCALES[1])
        unsure = (math.log(USUAL_SCALE) - self.scale_low) / (self.scale_high - self.scale_low)
        self.head.bias = nn.Parameter(torch.tensor([0.0, GATE_BIAS, 0.0, math.log(unsure / (1 - unsure))]))
        self.register_buffer("enlarging", _bilinear(4), persistent=False)

    enlarging: Tensor

    def forward(self, rgb: Tensor, coarse: Tensor) -> Tensor:
        validity = coarse[:, 1:2]
        # 1 / metres; 0 where there is none.
        disparity = validity * self.farthest + self.span * coarse[:, :1]
        weight = coarse[:, 2:3]
        cells = F.avg_pool2d(torch.cat([disparity * weight, validity, weight], 1), CELL)
        total, share, confidence = cells.chunk(3, 1)
        filled = fill(total / confidence.clamp(min=1e-6), confidence, self.usual)
        factor, gate, fill_factor, scale = self._learnt(rgb, filled, share, confidence).chunk(4, 1)
        believed = torch.sigmoid(gate)
        corrected = believed * torch.exp(math.log(LARGEST_FACTOR) * torch.tanh(factor))
        anew = filled * torch.exp(math.log(LARGEST_FILL_FACTOR) * torch.tanh(fill_factor))
        scale = self.scale_low + (self.scale_high - self.scale_low) * torch.sigmoid(scale)
        if not self.training:
            unconfirmed = math.log(UNCONFIRMED_SCALE) - self.scale_low
            scale = torch.maximum(scale, self.scale_low + unconfirmed * (1 - share))
        maps = _enlarge(torch.cat([corrected, believed, anew, scale], 1), self.enlarging)
        corrected, believed, anew, scale = maps.chunk(4, 1)
        said = corrected * disparity + (1 - believed * validity) * anew
        return torch.cat([((said - self.farthest) / self.span).clamp(0.0, 1.0), scale], 1)

    def _learnt(self, rgb: Tensor, filled: Tensor, share: Tensor, confidence: Tensor) -> Tensor:
        """[N, 4, H / 4, W / 4]: ln factor and gate of coarse depth, ln factor of filled depth, ln scale, each before
        its limits."""
        rows = torch.linspace(-1, 1, filled.shape[2], device=filled.device).view(1, 1, -1, 1).expand_as(filled)
        known = torch.cat([torch.log(filled), share, confidence, rows], 1)
        x = self.join(torch.cat([self.picture(self.stem(rgb * 2 - 1)), known], 1))
        pyramid = [x]
        for down in self.down:
            x = down(x)
            pyramid.append(x)
        for up, skip in zip(self.up, reversed(pyramid[:-1]), strict=True):
            x = up(torch.cat([_double(x), skip], 1))
        said: Tensor = self.head(x)
        return said


def _bilinear(channels: int) -> Tensor:
    """Weights that give each of the `CELL`^2 pixels of a cell from the 3x3 cells around it, [channels CELL^2, 1, 3, 3].
    A convolution and a reordering take a third of the time of a runtime's own resizing."""
    place = (torch.arange(CELL) + 0.5) / CELL - 0.5
    line = torch.stack([(-place).clamp(min=0), 1 - place.abs(), place.clamp(min=0)], 1)
    return torch.einsum("ai,bj->abij", line, line).reshape(CELL * CELL, 1, 3, 3).repeat(channels, 1, 1, 1)


def _enlarge(maps: Tensor, weights: Tensor) -> Tensor:
    """[N, C, h, w] to [N, C, CELL h, CELL w], bilinear, the border repeated."""
    # Not F.pad: some runtimes pad with zeros only.
    around = torch.cat([maps[:, :, :1], maps, maps[:, :, -1:]], 2)
    around = torch.cat([around[..., :1], around, around[..., -1:]], 3)
    return F.pixel_shuffle(F.conv2d(around, weights, groups=maps.shape[1]), CELL)
