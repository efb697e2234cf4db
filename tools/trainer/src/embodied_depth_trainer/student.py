"""The small depth network that runs on the robot's CPU.

It takes what EDN takes, a picture and coarse depth, and refines: where coarse depth is valid it says by which factor
that is wrong, where not it says the depth itself, and a gate learns how far to believe coarse depth. Untrained, it is
close to the coarse depth. Only operations that every runtime has: convolutions with zero padding, ReLU, resizing by
2, and a few functions of one pixel.
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
# The largest factor by which coarse depth is corrected in place; more is better said anew.
LARGEST_FACTOR = 1.5
# Depth that an untrained network says where there is no coarse depth: the middle of a room, metres.
USUAL_DEPTH_M = 2.5
# The Laplace scale of the error of ln depth lies between these. An untrained network is unsure: at 0.2, a depth is
# right within 25 % with a probability of 67 %, too little for the map.
SCALES = (0.01, 2.0)
USUAL_SCALE = 0.2
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


class Student(nn.Module):
    """`rgb` [N, 3, H, W] in 0..1 and `coarse` [N, 3, H, W] (disparity in 0..1 over the depth range, validity,
    confidence) to [N, 2, H, W]: disparity in 0..1, and ln b with b the Laplace scale of the error of ln depth. H and W
    are multiples of 32."""

    def __init__(self, depth_range_m: tuple[float, float] = (0.1, 20.0), widths: Sequence[int] = WIDTHS) -> None:
        super().__init__()
        near, far = depth_range_m
        self.farthest, self.span = 1 / far, 1 / near - 1 / far
        self.log_low, self.log_high = math.log(1 / far), math.log(1 / near)
        usual = min(max(USUAL_DEPTH_M, 1.01 * near), 0.99 * far)
        # Of the sigmoid that goes from the farthest to the nearest depth in logarithms.
        share = (math.log(1 / usual) - self.log_low) / (self.log_high - self.log_low)
        self.stem = nn.Sequential(
            nn.Conv2d(6, widths[0], 3, 2, 1, bias=False), nn.BatchNorm2d(widths[0]), nn.ReLU(inplace=True)
        )
        self.down = nn.ModuleList(
            nn.Sequential(_block(fine, wide, 2), _block(wide, wide)) for fine, wide in pairwise(widths)
        )
        self.up = nn.ModuleList(_block(wide + fine, fine) for fine, wide in reversed(list(pairwise(widths))))
        self.head = nn.Conv2d(widths[0], 4, 3, padding=1)
        nn.init.normal_(self.head.weight, std=1e-3)
        self.scale_low, self.scale_high = math.log(SCALES[0]), math.log(SCALES[1])
        unsure = (math.log(USUAL_SCALE) - self.scale_low) / (self.scale_high - self.scale_low)
        bias = [0.0, GATE_BIAS, math.log(share / (1 - share)), math.log(unsure / (1 - unsure))]
        self.head.bias = nn.Parameter(torch.tensor(bias))

    def forward(self, rgb: Tensor, coarse: Tensor) -> Tensor:
        x = self.stem(torch.cat([rgb * 2 - 1, coarse], 1))
        pyramid = [x]
        for down in self.down:
            x = down(x)
            pyramid.append(x)
        for up, skip in zip(self.up, reversed(pyramid[:-1]), strict=True):
            x = up(torch.cat([F.interpolate(x, scale_factor=2.0, mode="nearest"), skip], 1))
        said = F.interpolate(self.head(x), scale_factor=2.0, mode="bilinear", align_corners=False)
        factor, gate, free, scale = said.chunk(4, 1)
        disparity, validity = coarse[:, :1], coarse[:, 1:2]
        corrected = torch.log(self.farthest + self.span * disparity) + math.log(LARGEST_FACTOR) * torch.tanh(factor)
        anew = self.log_low + (self.log_high - self.log_low) * torch.sigmoid(free)
        log_disparity = anew + validity * torch.sigmoid(gate) * (corrected - anew)
        x = ((torch.exp(log_disparity) - self.farthest) / self.span).clamp(0.0, 1.0)
        return torch.cat([x, self.scale_low + (self.scale_high - self.scale_low) * torch.sigmoid(scale)], 1)
