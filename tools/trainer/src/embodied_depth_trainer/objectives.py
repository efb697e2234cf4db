"""What networks that do more than explain one picture by its neighbours minimise: SC-Depth and ManyDepth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from .batches import Batch, to_depth
from .inputs import second_input
from .losses import LossOptions, View, self_supervision
from .manydepth import ManyDepth, consistency, untrustworthy
from .warp import invert_rigid

if TYPE_CHECKING:
    from .training import Trainer

# Weights of Bian et al. 2019 (SC-SfMLearner); what is not named here is the same for all.
RECIPES = {"sc_depth_r18": LossOptions(smoothness=0.1, geometry=0.5, auto_mask=True, both_ways=True)}


def recipe(network: str) -> LossOptions:
    """The loss that a network's authors train it with."""
    return RECIPES.get(network, LossOptions())


def both_ways(trainer: Trainer, batch: Batch) -> Tensor:
    """Every target explained by each of its sources and the other way round, depths of both being learnt. Scalar."""
    settings = trainer.settings
    extra = [
        second_input(trainer.network, trainer.frames, batch.sources[:, view], settings.depth_range_m, trainer.device)
        for view in range(len(batch.source_pictures))
    ]
    seen, second = torch.cat([batch.seen, *batch.source_pictures]), torch.cat([batch.coarse, *extra])
    disparity, _ = trainer.look(seen, second)
    depth_m, *source_depths = to_depth(disparity, settings.depth_range_m).chunk(1 + len(batch.source_pictures))
    losses = []
    for picture, source_m, pose in zip(batch.source_pictures, source_depths, batch.t_source_target, strict=True):
        there = View(picture, trainer.projector(depth_m, pose), source_m)
        back = View(batch.picture, trainer.projector(source_m, invert_rigid(pose)), depth_m)
        noise = trainer.noise()
        losses += [
            self_supervision(batch.picture, 1 / depth_m, [there], settings.loss, noise),
            self_supervision(picture, 1 / source_m, [back], settings.loss, noise),
        ]
    return torch.stack(losses).mean()


def with_teacher(trainer: Trainer, batch: Batch) -> Tensor:
    """ManyDepth: photometric where volume and teacher agree, else the teacher's depth. The teacher learns with it until
    `teacher_steps`, then stays. Scalar."""
    settings, network = trainer.settings, trainer.network
    assert isinstance(network, ManyDepth)
    learning = trainer.step < settings.teacher_steps
    network.teacher.train(learning)
    with torch.set_grad_enabled(learning), trainer.autocast():
        teacher_m = to_depth(network.teacher(batch.seen), settings.depth_range_m)
    disparity, _ = trainer.look(batch.seen, batch.coarse)
    depth_m = to_depth(disparity, settings.depth_range_m)
    taught = untrustworthy(batch.coarse, network.depths_m, teacher_m.detach())

    def photometric(depth: Tensor, where: Tensor | None) -> Tensor:
        seen = zip(batch.source_pictures, batch.t_source_target, strict=True)
        views = [View(picture, trainer.projector(depth, pose)) for picture, pose in seen]
        return self_supervision(batch.picture, 1 / depth, views, settings.loss, trainer.noise(), where)

    loss = photometric(depth_m, ~taught) + consistency(depth_m, teacher_m, taught)
    return loss + photometric(teacher_m, None) if learning else loss
