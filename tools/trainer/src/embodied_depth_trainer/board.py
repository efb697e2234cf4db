"""What TensorBoard shows of a training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from .batches import rgb_planes
from .depth_networks import output_of
from .errors import TrainerError
from .inputs import second_input
from .training import Trainer

SCALARS_EVERY, PICTURES_EVERY = 10, 200


class Board:
    """Writes the loss, and now and then a picture above its depth."""

    def __init__(self, folder: Path, trainer: Trainer) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise TrainerError("--tensorboard needs `pip install tensorboard`") from None
        self.writer = SummaryWriter(str(folder))
        self.trainer = trainer

    def told(self, step: int, loss: float) -> None:
        if step % SCALARS_EVERY == 0:
            self.writer.add_scalar("loss", loss, step)
        if step % PICTURES_EVERY == 0:
            self.writer.add_image("picture and disparity", self._picture(), step)

    def close(self) -> None:
        self.writer.close()

    @torch.no_grad()
    def _picture(self) -> torch.Tensor:
        """[3, 2 H, W] of the first target; bright is near, to the square root, so that far things show."""
        trainer = self.trainer
        index = trainer.pairs.targets[:1].astype(np.int64)
        second = second_input(trainer.network, trainer.frames, index, trainer.settings.depth_range_m, trainer.device)
        rgb = rgb_planes(trainer.frames, index, trainer.device)
        trainer.network.eval()
        disparity, _ = output_of(trainer.network, rgb, second)
        trainer.network.train()
        return torch.cat([rgb[0], disparity[0].sqrt().expand(3, -1, -1)], 1).cpu()
