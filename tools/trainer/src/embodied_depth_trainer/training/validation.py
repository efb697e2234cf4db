"""Validation on frames of held-out places, and whether a training learns anything that shows there.

No ground truth is used: the losses are those of the training, and depth is compared with labels or, without them, with
confident coarse depth, also where coarse depth was dropped from the network's input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from embodied_depth_trainer.data.batches import Batch, coarse_planes, to_depth
from embodied_depth_trainer.data.pairs import Pairs
from embodied_depth_trainer.losses.depth_supervision import LN_TOLERANCE, at_cell_centres
from embodied_depth_trainer.networks.registry import takes_coarse
from embodied_depth_trainer.training.trainer import UNCERTAINTY, Trainer

# Gain over the initial network that counts: this share of the initial loss. It is certain above this many standard
# errors of the mean of the differences, frame by frame. Neighbouring frames are alike, so that is rather too little.
LEAST_GAIN = 0.01
STANDARD_ERRORS = 2.0
# Coarse depth of at least this confidence stands in for labels.
MIN_CONFIDENCE = 0.7


@dataclass(frozen=True)
class Measured:
    """What a network does on the validation frames."""

    parts: dict[str, float]
    """Mean of each weighted part of the loss."""
    depth_losses: NDArray[np.float64]
    """[frames]; the loss of each frame without the part that trains the uncertainty."""
    right: float
    """Share of the labelled cells whose depth is within 25 % of the label."""
    right_in_holes: float
    """The same where there is no coarse depth, or where the network was not given what there is; NaN if there is no
    such cell, or the network is given no depth."""

    @property
    def loss(self) -> float:
        return sum(self.parts.values())

    @property
    def depth_loss(self) -> float:
        """The loss without the part that trains the uncertainty, which can fall while depth stays the same."""
        return float(self.depth_losses.mean())


@dataclass(frozen=True)
class Verdict:
    """Whether the loss of depth is lower than that of the initial network."""

    initial: float
    now: float
    least: float
    """What the loss must fall by to count."""
    noise: float
    """What it must fall by to be more than chance among the frames."""
    frames: int

    @property
    def has_learnt(self) -> bool:
        return self.initial - self.now > max(self.least, self.noise)

    @property
    def is_nothing(self) -> bool:
        """Whether the gain would be too small even if it were certain."""
        # `not >` instead of `<=`, so that NaN is nothing.
        return not self.initial - self.now > self.least

    def __str__(self) -> str:
        said = (
            f"the loss of depth on {self.frames} held-out frames is {self.now:.4f}, that of the initial network "
            f"{self.initial:.4f}"
        )
        if self.has_learnt:
            return f"learnt: {said}"
        if self.is_nothing:
            return (
                f"NOTHING IS LEARNT: {said}, and {self.initial - self.least:.4f} would count; "
                "give other frames, more of them, labels, more --steps, or another --learning-rate"
            )
        return (
            f"it is not certain that anything is learnt: {said}, a difference up to {self.noise:.4f} can be chance; "
            "record more places to know"
        )


def verdict(initial: Measured, now: Measured) -> Verdict:
    """Compares two measurements of the same frames."""
    gains = initial.depth_losses - now.depth_losses
    error = float(gains.std(ddof=1)) / math.sqrt(len(gains)) if len(gains) > 1 else 0.0
    least = LEAST_GAIN * abs(initial.depth_loss)
    return Verdict(initial.depth_loss, now.depth_loss, least, STANDARD_ERRORS * error, len(gains))


class Validation:
    """The frames of held-out places, the same for every measurement."""

    def __init__(self, pairs: Pairs) -> None:
        self.targets = pairs.targets
        if not pairs.have_sources:
            self.sources: NDArray[np.int64] = np.empty((len(pairs), 0), np.int64)
            return
        # The source in the middle of each side: neither the shortest nor the longest baseline.
        sides = [[side for side in both if len(side)] for both in zip(pairs.earlier, pairs.later, strict=True)]
        sources = [[side[0][len(side[0]) // 2], side[-1][len(side[-1]) // 2]] for side in sides]
        self.sources = np.array(sources, np.int64).reshape(-1, 2)

    def __len__(self) -> int:
        return len(self.targets)

    @torch.no_grad()
    def measure(self, trainer: Trainer) -> Measured:
        """Measures the trainer's network as it is now; the training continues as if nothing had happened."""
        was_training = trainer.network.training
        trainer.network.eval()
        losses: list[dict[str, float]] = []
        counts = np.zeros((2, 2))
        for target, sources in zip(self.targets, self.sources, strict=True):
            batch = trainer.fixed_batch(int(target), sources)
            losses.append({name: float(part) for name, part in trainer.loss_parts(batch).items()})
            counts += _right(trainer, batch)
        trainer.network.train(was_training)
        parts = {name: float(np.mean([loss[name] for loss in losses])) for name in losses[0]}
        depth = [sum(part for name, part in loss.items() if name != UNCERTAINTY) for loss in losses]
        right = [float(hits / count) if count else math.nan for hits, count in counts]
        return Measured(parts, np.array(depth), right[0], right[1])


def _right(trainer: Trainer, batch: Batch) -> NDArray[np.float64]:
    """[2, 2]: right and all cells with a label, of these right and all without coarse depth."""
    disparity, _ = trainer.predict(batch.augmented, batch.coarse)
    depth_m = to_depth(disparity, trainer.settings.depth_range_m)
    missing = _missing(trainer, batch)
    if batch.labels is not None:
        label_m = batch.labels[:, :1]
        depth_m, missing = at_cell_centres(depth_m, batch.labels), at_cell_centres(missing, batch.labels)
        labelled = label_m > 0
    else:
        label_m = to_depth(batch.coarse_full[:, :1], trainer.settings.depth_range_m)
        labelled = batch.coarse_full[:, 2:3] >= MIN_CONFIDENCE
    right = (depth_m.log() - label_m.clamp(min=1e-3).log()).abs() < LN_TOLERANCE

    def count(where: Tensor) -> list[float]:
        return [float((right & where).sum()), float(where.sum())]

    return np.array([count(labelled), count(labelled & missing)])


def _missing(trainer: Trainer, batch: Batch) -> Tensor:
    """Where coarse depth is missing [B, 1, H, W]; dense depth has a value everywhere and does not say."""
    if not takes_coarse(trainer.network):
        return torch.zeros_like(batch.image[:, :1], dtype=torch.bool)
    coarse = batch.coarse
    if trainer.settings.given_depth == "dense":
        coarse = coarse_planes(trainer.recorded, batch.targets, trainer.settings.depth_range_m, trainer.device)
    missing: Tensor = coarse[:, 1:2] == 0
    return missing
