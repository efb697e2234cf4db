"""The losses of networks that need more than the plain reprojection loss: SC-Depth and ManyDepth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from embodied_depth_trainer.data.batches import Batch, to_depth
from embodied_depth_trainer.data.projection import invert_rigid
from embodied_depth_trainer.losses.reprojection import View, supervision_parts
from embodied_depth_trainer.networks.inputs import second_input
from embodied_depth_trainer.networks.manydepth import ManyDepth, teacher_error, unreliable

if TYPE_CHECKING:
    from embodied_depth_trainer.training.trainer import Trainer


def bidirectional_parts(trainer: Trainer, batch: Batch) -> dict[str, Tensor]:
    """The parts of SC-Depth's loss: every target is warped from each of its sources and the other way round, and the
    depth of both is trained. Scalars."""
    settings = trainer.settings
    extra = [
        second_input(trainer.network, trainer.frames, batch.sources[:, view], settings.depth_range_m, trainer.device)
        for view in range(len(batch.source_images))
    ]
    images = torch.cat([batch.augmented, *batch.source_images])
    second = torch.cat([batch.coarse, *extra])
    disparity, _ = trainer.predict(images, second)
    depth_m, *source_depths = to_depth(disparity, settings.depth_range_m).chunk(1 + len(batch.source_images))
    losses = []
    for image, source_m, pose in zip(batch.source_images, source_depths, batch.t_source_target, strict=True):
        forward = View(image, trainer.projector(depth_m, pose), source_m)
        backward = View(batch.image, trainer.projector(source_m, invert_rigid(pose)), depth_m)
        noise = trainer.noise()
        losses += [
            supervision_parts(batch.image, 1 / depth_m, [forward], settings.loss, noise),
            supervision_parts(image, 1 / source_m, [backward], settings.loss, noise),
        ]
    return {name: torch.stack([parts[name] for parts in losses]).mean() for name in losses[0]}


def manydepth_parts(trainer: Trainer, batch: Batch) -> dict[str, Tensor]:
    """The parts of ManyDepth's loss: photometric where volume and teacher agree, elsewhere the distance to the
    teacher's depth. The teacher is trained along until `teacher_steps`, then it is frozen. Scalars."""
    settings = trainer.settings
    network = trainer.network
    assert isinstance(network, ManyDepth)
    learning = trainer.step < settings.teacher_steps
    # A validation changes neither the teacher nor its statistics.
    network.teacher.train(learning and network.training)
    with torch.set_grad_enabled(learning and network.training), trainer.autocast():
        teacher_m = to_depth(network.teacher(batch.augmented), settings.depth_range_m)
    disparity, _ = trainer.predict(batch.augmented, batch.coarse)
    depth_m = to_depth(disparity, settings.depth_range_m)
    taught = unreliable(batch.coarse, network.depths_m, teacher_m.detach())

    def photometric(depth: Tensor, where: Tensor | None) -> dict[str, Tensor]:
        sources = zip(batch.source_images, batch.t_source_target, strict=True)
        views = [View(image, trainer.projector(depth, pose)) for image, pose in sources]
        return supervision_parts(batch.image, 1 / depth, views, settings.loss, trainer.noise(), where)

    parts = {**photometric(depth_m, ~taught), "agreement with teacher": teacher_error(depth_m, teacher_m, taught)}
    if learning:
        parts |= {f"teacher's {name}": part for name, part in photometric(teacher_m, None).items()}
    return parts
