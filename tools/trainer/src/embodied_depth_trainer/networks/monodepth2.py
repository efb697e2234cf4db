"""Monodepth2 (Godard et al. 2019)."""

from __future__ import annotations

from torch import Tensor, nn

from embodied_depth_trainer.networks.resnet import PYRAMID, Decoder, Encoder, Padding


class Monodepth2(nn.Module):
    """Depth from an image alone (Godard et al. 2019); SC-Depth's depth network (Bian et al. 2019) is the same."""

    def __init__(self, padding: Padding = "zeros") -> None:
        super().__init__()
        self.rgb = Encoder(3, (0.45,) * 3, (0.225,) * 3)
        self.decoder = Decoder(PYRAMID, padding)

    def forward(self, rgb: Tensor) -> Tensor:
        disparity: Tensor = self.decoder(self.rgb(rgb))
        return disparity
