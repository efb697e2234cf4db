"""The ResNet18 encoder and the decoder that Monodepth2, ManyDepth and EDN share.

Images are RGB in 0..1, `[N, 3, H, W]`, with H and W multiples of 32. The output is x in 0..1, `[N, 1, H, W]`, with
disparity = 1/max + (1/min - 1/max) x and depth = 1/disparity.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torchvision.models import resnet18

Padding = Literal["zeros", "reflect"]

# Channels of a ResNet18 pyramid at 1/2, 1/4, ... 1/32 of the size (He et al. 2016).
PYRAMID = (64, 64, 128, 256, 512)
# Channels of the decoder at full size, 1/2, ... 1/16 (Godard et al. 2019, Monodepth2, supplementary table 1).
DECODER = (16, 32, 64, 128, 256)


class Encoder(nn.Module):
    """The five feature maps of a ResNet18 with `channels` input planes."""

    mean: Tensor
    std: Tensor

    def __init__(self, channels: int, mean: Sequence[float], std: Sequence[float]) -> None:
        super().__init__()
        resnet = resnet18(weights=None)
        self.register_buffer("mean", torch.tensor(mean).view(1, -1, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(1, -1, 1, 1), persistent=False)
        conv: nn.Module = resnet.conv1 if channels == 3 else nn.Conv2d(channels, 64, 7, 2, 3, bias=False)
        self.stem = nn.Sequential(conv, resnet.bn1, nn.ReLU())
        self.pool = resnet.maxpool
        self.layers = nn.ModuleList([resnet.layer1, resnet.layer2, resnet.layer3, resnet.layer4])

    def forward(self, planes: Tensor) -> list[Tensor]:
        features = [self.stem((planes - self.mean) / self.std)]
        last = self.pool(features[0])
        for layer in self.layers:
            last = layer(last)
            features.append(last)
        return features


class Decoder(nn.Module):
    """From a feature pyramid to x in 0..1: five times convolution, nearest x2, skip connection, convolution; then
    sigmoid."""

    def __init__(self, pyramid: Sequence[int], padding: Padding) -> None:
        super().__init__()
        self.before = nn.ModuleList()
        self.after = nn.ModuleList()
        channels = pyramid[-1]
        for level in reversed(range(5)):
            skip = pyramid[level - 1] if level > 0 else 0
            self.before.append(_conv(channels, DECODER[level], padding))
            self.after.append(_conv(DECODER[level] + skip, DECODER[level], padding))
            channels = DECODER[level]
        self.head = _conv(channels, 1, padding)

    def forward(self, features: list[Tensor]) -> Tensor:
        x = features[-1]
        for step, (before, after) in enumerate(zip(self.before, self.after, strict=True)):
            x = F.interpolate(F.elu(before(x)), scale_factor=2.0, mode="nearest")
            if step < 4:
                x = torch.cat([x, features[3 - step]], dim=1)
            x = F.elu(after(x))
        # In float32 also under autocast: bfloat16 would quantise depth in steps of 1.5 %.
        with torch.autocast(x.device.type, enabled=False):
            return torch.sigmoid(self.head(x.float()))


def _conv(inputs: int, outputs: int, padding: Padding) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode=padding)
