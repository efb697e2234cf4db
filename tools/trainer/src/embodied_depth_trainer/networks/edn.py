"""EDN, the network of Embodied Depth Prediction (Liu et al.)."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from embodied_depth_trainer.networks.resnet import PYRAMID, Decoder, Encoder, Padding

Fusion = Literal["add", "concat"]


class Edn(nn.Module):
    """RGB and coarse depth through two ResNet18 encoders, fused level by level (Liu et al., Embodied Depth
    Prediction).

    `add` is what the paper describes, `concat` what its released runs use. The coarse planes are disparity in 0..1
    over the depth range, validity and confidence: disparity alone would be ambiguous, since 0 is both "far" and
    "none".
    """

    def __init__(self, fusion: Fusion = "add", padding: Padding = "zeros") -> None:
        super().__init__()
        self.fusion = fusion
        # ImageNet's statistics, which belong to the weights of the RGB encoder.
        self.rgb = Encoder(3, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
        self.coarse = Encoder(3, (0.0,) * 3, (1.0,) * 3)
        pyramid = PYRAMID if fusion == "add" else tuple(2 * channels for channels in PYRAMID)
        self.decoder = Decoder(pyramid, padding)

    def forward(self, rgb: Tensor, coarse: Tensor) -> Tensor:
        pairs = zip(self.rgb(rgb), self.coarse(coarse), strict=True)
        fused = [a + b if self.fusion == "add" else torch.cat([a, b], dim=1) for a, b in pairs]
        disparity: Tensor = self.decoder(fused)
        return disparity
