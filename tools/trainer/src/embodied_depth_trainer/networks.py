"""The depth networks: Monodepth2 and Embodied Depth's EDN, both on ResNet18.

Pictures are RGB in 0..1, `[N, 3, H, W]`, H and W multiples of 32. The output is x in 0..1, `[N, 1, H, W]`, with
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
Fusion = Literal["add", "concat"]

# Channels of a ResNet18 pyramid at 1/2, 1/4, ... 1/32 of the size (He et al. 2016).
PYRAMID = (64, 64, 128, 256, 512)
# Channels of the decoder at full size, 1/2, ... 1/16 (Godard et al. 2019, Monodepth2, supplementary table 1).
DECODER = (16, 32, 64, 128, 256)


class Encoder(nn.Module):
    """The five feature maps of a ResNet18 that takes `channels` planes."""

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
    """From a pyramid to x in 0..1: five times convolution, nearest x2, skip connection, convolution; then sigmoid."""

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
        # In float32 also under autocast: bfloat16 would say depth in steps of 1.5 %.
        with torch.autocast(x.device.type, enabled=False):
            return torch.sigmoid(self.head(x.float()))


def _conv(inputs: int, outputs: int, padding: Padding) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode=padding)


class Monodepth2(nn.Module):
    """RGB only (Godard et al. 2019); SC-Depth's depth network (Bian et al. 2019) is the same."""

    def __init__(self, padding: Padding = "zeros") -> None:
        super().__init__()
        self.rgb = Encoder(3, (0.45,) * 3, (0.225,) * 3)
        self.decoder = Decoder(PYRAMID, padding)

    def forward(self, rgb: Tensor) -> Tensor:
        disparity: Tensor = self.decoder(self.rgb(rgb))
        return disparity


class Edn(nn.Module):
    """RGB and coarse depth through two ResNet18, fused level by level (Liu et al., Embodied Depth Prediction).

    `add` is what the paper says, `concat` what its released runs do. Coarse planes are disparity in 0..1 over the depth
    range, validity, confidence: with 0 meaning both "far" and "none", disparity alone would be ambiguous.
    """

    def __init__(self, fusion: Fusion = "add", padding: Padding = "zeros") -> None:
        super().__init__()
        self.fusion = fusion
        # ImageNet's statistics, which the weights of the RGB encoder come with.
        self.rgb = Encoder(3, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
        self.coarse = Encoder(3, (0.0,) * 3, (1.0,) * 3)
        pyramid = PYRAMID if fusion == "add" else tuple(2 * channels for channels in PYRAMID)
        self.decoder = Decoder(pyramid, padding)

    def forward(self, rgb: Tensor, coarse: Tensor) -> Tensor:
        pairs = zip(self.rgb(rgb), self.coarse(coarse), strict=True)
        fused = [a + b if self.fusion == "add" else torch.cat([a, b], dim=1) for a, b in pairs]
        disparity: Tensor = self.decoder(fused)
        return disparity
