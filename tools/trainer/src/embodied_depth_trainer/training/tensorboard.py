"""Writes the progress of a training for TensorBoard."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from embodied_depth_trainer.data.batches import rgb_planes
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.inputs import second_input
from embodied_depth_trainer.networks.registry import output_of
from embodied_depth_trainer.training.trainer import Trainer

SCALARS_EVERY = 10
IMAGES_EVERY = 200


class Board:
    """Writes the loss and its parts, at intervals an image above its predicted disparity, and every validation."""

    def __init__(self, folder: Path, trainer: Trainer) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise TrainerError("--tensorboard needs `pip install tensorboard`") from None
        self.writer = SummaryWriter(str(folder))
        self.trainer = trainer

    def record(self, step: int, loss: float) -> None:
        if step % SCALARS_EVERY == 0:
            self.writer.add_scalar("loss", loss, step)
            for name, part in self.trainer.parts.items():
                self.writer.add_scalar(f"training/{name}", float(part), step)
        if step % IMAGES_EVERY == 0:
            self.writer.add_image("image and disparity", self._image(), step)

    def report(self, step: int, numbers: Mapping[str, float]) -> None:
        """Writes the numbers of a validation by their names."""
        for name, value in numbers.items():
            if math.isfinite(value) and name != "loss":
                # A group of the parts: `validation: labels` becomes `validation/labels`.
                self.writer.add_scalar(name.replace(": ", "/"), value, step)

    def close(self) -> None:
        self.writer.close()

    @torch.no_grad()
    def _image(self) -> torch.Tensor:
        """The image and the disparity of the first target [3, 2 H, W]. Near is bright; the square root keeps far
        objects visible."""
        trainer = self.trainer
        index = trainer.pairs.targets[:1].astype(np.int64)
        second = second_input(trainer.network, trainer.frames, index, trainer.settings.depth_range_m, trainer.device)
        rgb = rgb_planes(trainer.frames, index, trainer.device)
        trainer.network.eval()
        disparity, _ = output_of(trainer.network, rgb, second)
        trainer.network.train()
        return torch.cat([rgb[0], disparity[0].sqrt().expand(3, -1, -1)], 1).cpu()
