"""Trains a depth network on recorded frames, without a depth sensor.

Every step derives its randomness from (seed, step), so an interrupted training continues exactly as if it had not
stopped, bit by bit on the CPU with the same number of threads.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from embodied_depth_trainer import processes
from embodied_depth_trainer.data.batches import ALL, Batch, coarse_dropout_mask, make_batch, to_depth
from embodied_depth_trainer.data.frame_set import FrameSet, giving
from embodied_depth_trainer.data.pairs import Pairs
from embodied_depth_trainer.data.prefetch import Prefetcher
from embodied_depth_trainer.data.projection import Projector
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.losses.depth_supervision import coarse_error, correctness_nll, label_error, laplace_nll
from embodied_depth_trainer.losses.lidar import lidar_error
from embodied_depth_trainer.losses.reprojection import View, supervision_parts
from embodied_depth_trainer.networks.cost_volume import volume_planes
from embodied_depth_trainer.networks.exported import average_longer, restore_statistics
from embodied_depth_trainer.networks.imagenet_weights import load_imagenet
from embodied_depth_trainer.networks.inputs import give, second_input
from embodied_depth_trainer.networks.manydepth import ManyDepth, VolumeAugmentation
from embodied_depth_trainer.networks.registry import SIZE_STEP, build_network, output_of, takes_coarse
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training import history
from embodied_depth_trainer.training.checkpoint import Checkpoint
from embodied_depth_trainer.training.heap import keep_freed_memory
from embodied_depth_trainer.training.initial import STATISTICS_BATCHES, is_exported, load_initial
from embodied_depth_trainer.training.objectives import bidirectional_parts, manydepth_parts
from embodied_depth_trainer.training.settings import Settings

CHECKPOINT_FILE = "checkpoint.pt"
BAD_BATCH_FILE = "bad_batch.pt"


# Seed of what validation drops, which no option changes, so that trainings can be compared.
VALIDATION_SEED = 77
# The part of the loss that trains the predicted scale of the error and not depth.
UNCERTAINTY = "uncertainty"


def total(parts: Mapping[str, Tensor]) -> Tensor:
    """The sum of the parts of a loss. Scalar."""
    if not parts:
        raise TrainerError("every weight of the loss is 0, so there is nothing to train; give one of them a weight")
    return torch.stack(list(parts.values())).sum()


class NotFiniteError(TrainerError):
    """The loss or its gradient is NaN or infinite."""


class Trainer:
    """The network, the optimiser and the frames, and one step of training."""

    def __init__(
        self,
        frames: FrameSet,
        pairs: Pairs,
        settings: Settings,
        device: torch.device | str = "cpu",
        readers: int = 1,
        dataset: Mapping[str, Any] | None = None,
    ) -> None:
        """`dataset` is the summary of the shards that the frames come from, which checkpoints keep."""
        height = frames.camera.height
        width = frames.camera.width
        if height % SIZE_STEP or width % SIZE_STEP:
            raise TrainerError(
                f"the networks halve the size five times and cannot take {height}x{width} images; "
                f"give --size with multiples of {SIZE_STEP}"
            )
        if settings.batch % processes.count():
            raise TrainerError(
                f"a batch of {settings.batch} cannot be divided among {processes.count()} processes; "
                "give a multiple with --batch"
            )
        lost = ~np.isfinite(frames.t_world_camera).all(axis=(1, 2))
        if lost.any():
            raise TrainerError(
                f"{lost.sum()} of {len(frames)} poses are not finite, the first is {int(lost.argmax())}; "
                "remove these frames"
            )
        if settings.init is not None and settings.encoder is not None:
            raise TrainerError(
                f"--init {settings.init} would replace the weights of --encoder {settings.encoder}; give one of the two"
            )
        if settings.lidar_weight > 0 and frames.lidar is None:
            raise TrainerError(
                "--lidar-weight needs LiDAR scans, which only recordings have; give --store instead of --dataset"
            )
        self.recorded = frames
        """The frames with coarse depth, whatever the network is given."""
        frames = giving(frames, settings.given_depth)
        self.frames = frames
        self.pairs = pairs
        self.settings = settings
        self.device = device
        network = build_network(settings.network, settings.depth_range_m, settings.seed)
        if settings.encoder is not None:
            load_imagenet(network, settings.encoder)
        if settings.init is not None:
            load_initial(network, settings.network, settings.depth_range_m, settings.init)
            average_longer(network)
        # Channels last, which convolutions on CPUs prefer.
        network = network.to(device).to(memory_format=torch.channels_last)
        self.network = give(processes.share_batch_norms(network), settings.given_depth)
        if takes_coarse(self.network) and frames.coarse is None:
            raise TrainerError(
                f"`{settings.network}` takes coarse depth, which these frames lack; prepare the recordings without "
                "--coarse none, or train `monodepth2_r18`"
            )
        if settings.lidar_weight > 0 and (isinstance(self.network, ManyDepth) or settings.loss.both_ways):
            raise TrainerError(
                f"`{settings.network}` has its own loss, which does not use the LiDAR; omit --lidar-weight"
            )
        # The fused optimiser makes one pass over the weights instead of a dozen.
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate, fused=True)
        self.projector = Projector(frames.camera, device)
        self.step = 0
        self.dataset = dataset
        self.history = [history.begun(0, dataset)]
        self.parts: dict[str, Tensor] = {}
        if settings.init is not None and is_exported(settings.init):
            self._restore_statistics()
        self.batches = Prefetcher(self.batch, readers)

    def resume(self, saved: Checkpoint, file: Path) -> None:
        """Continues from a checkpoint of the same settings."""
        now = self.settings.as_dict(self.frames)
        # Settings that did not exist yet were off, as `None` is.
        different = [key for key in now if saved.settings.get(key) != now[key]]
        if different:
            was = {key: saved.settings.get(key) for key in different}
            raise TrainerError(
                f"{file} was trained with {was}, now "
                f"{ {key: now[key] for key in different} } is requested; give the same settings or another --out"
            )
        self.network.load_state_dict(saved.weights)
        self.optimizer.load_state_dict(saved.optimizer)
        self.step = saved.step
        self.history = history.continued(saved.history, saved.step, self.dataset)
        if len(self.history) > 1 and processes.rank() == 0:
            print("\n".join(history.described(self.history)), file=sys.stderr)

    def checkpoint(self) -> Checkpoint:
        weights = {name: value.cpu() for name, value in self.network.state_dict().items()}
        settings = self.settings.as_dict(self.frames)
        optimizer = self.optimizer.state_dict()
        return Checkpoint(self.step, self.settings.network, settings, weights, optimizer, self.history)

    def batch(self, step: int) -> Batch:
        """This process's share of the batch of a step."""
        return self.part_of_batch(step, slice(processes.rank(), None, processes.count()))

    def part_of_batch(self, step: int, mine: slice) -> Batch:
        """These samples of the batch of a step; no others are read."""
        random = np.random.default_rng([self.settings.seed, step])
        targets, sources = self.pairs.sample(self.settings.batch, random)
        augment = random if self.settings.augment else None
        range_m = self.settings.depth_range_m
        change = self.settings.color_change
        batch = make_batch(self.frames, targets, sources, range_m, augment, self.device, mine, change)
        if self.settings.given_depth == "dense":
            # It has no holes that the network would have to learn to fill.
            batch = replace(batch, coarse=batch.coarse_full)
        if isinstance(self.network, ManyDepth):
            drawn = VolumeAugmentation.none() if augment is None else VolumeAugmentation.draw(len(targets), augment)
            batch = self._with_volume(batch, drawn.of(mine))
        width = self.settings.crop_width
        # Narrower images are used whole.
        if 0 < width < self.frames.camera.width:
            places = (self.frames.camera.width - width) // SIZE_STEP + 1
            batch = batch.cropped(SIZE_STEP * int(random.integers(places)), width)
        return batch

    def fixed_batch(self, target: int, sources: NDArray[np.int64]) -> Batch:
        """A batch of one frame for validation: colours as they are, coarse depth dropped as in training but the same
        way every time."""
        one = np.array([target], np.int64)
        batch = make_batch(self.frames, one, sources[None], self.settings.depth_range_m, None, self.device)
        if isinstance(self.network, ManyDepth):
            return self._with_volume(batch, VolumeAugmentation.none())
        if self.settings.augment and self.settings.given_depth == "coarse" and self.frames.coarse is not None:
            kept = coarse_dropout_mask(batch.coarse.shape, np.random.default_rng([VALIDATION_SEED, target]))
            batch = replace(batch, coarse=batch.coarse * kept.to(batch.coarse.device))
        return batch

    def _with_volume(self, batch: Batch, augmentation: VolumeAugmentation) -> Batch:
        """Replaces coarse depth by the cost volume."""
        assert isinstance(self.network, ManyDepth)
        planes = volume_planes(self.frames, batch.targets, self.network.depths_m, self.device, augmentation.still)
        if augmentation.empty is not None:
            planes[torch.from_numpy(augmentation.empty).to(planes.device)] = 0
        return replace(batch, coarse=planes)

    def _restore_statistics(self) -> None:
        """Gives the batch norms of a loaded ONNX file the statistics of the first batches."""
        batches = (self.part_of_batch(step, ALL) for step in range(STATISTICS_BATCHES))
        takes_two = takes_coarse(self.network)
        inputs = ((b.augmented, b.coarse) if takes_two else (b.augmented,) for b in batches)
        restore_statistics(self.network, inputs)

    def loss(self, batch: Batch) -> Tensor:
        """The loss of a batch. Scalar."""
        return total(self.loss_parts(batch))

    def loss_parts(self, batch: Batch) -> dict[str, Tensor]:
        """The weighted parts of the loss, which add up to it. Scalars."""
        if isinstance(self.network, ManyDepth):
            return manydepth_parts(self, batch)
        if self.settings.loss.both_ways:
            return bidirectional_parts(self, batch)
        return self.parts_of(batch, *self.predict(batch.augmented, batch.coarse))

    def loss_of(self, batch: Batch, disparity: Tensor, log_scale: Tensor | None) -> Tensor:
        """The loss of a prediction. Scalar."""
        return total(self.parts_of(batch, disparity, log_scale))

    def parts_of(self, batch: Batch, disparity: Tensor, log_scale: Tensor | None) -> dict[str, Tensor]:
        """The weighted parts of the loss of a prediction. Scalars."""
        settings = self.settings
        depth_m = to_depth(disparity, settings.depth_range_m)
        parts: dict[str, Tensor] = {}
        if settings.photometric_weight > 0:
            found = self._photometric(batch, depth_m)
            parts |= {name: settings.photometric_weight * part for name, part in found.items()}
        if settings.coarse_weight > 0 and self.frames.coarse is not None:
            error = coarse_error(depth_m, batch.coarse_full, settings.depth_range_m)
            parts["coarse depth"] = settings.coarse_weight * error
        if settings.label_weight > 0 and batch.labels is not None:
            parts["labels"] = settings.label_weight * label_error(depth_m, batch.labels)
        if settings.lidar_weight > 0 and batch.lidar is not None:
            parts["lidar"] = settings.lidar_weight * lidar_error(depth_m, batch.lidar)
        if log_scale is not None:
            if batch.labels is None:
                nll = laplace_nll(depth_m.detach(), log_scale, batch.coarse_full, settings.depth_range_m)
            else:
                nll = correctness_nll(depth_m.detach(), log_scale, batch.labels)
            parts[UNCERTAINTY] = settings.uncertainty_weight * nll
        return parts

    def predict(self, rgb: Tensor, second: Tensor) -> tuple[Tensor, Tensor | None]:
        """The network's prediction; see `output_of`."""
        with self.autocast():
            return output_of(self.network, rgb, second)

    def autocast(self) -> torch.autocast:
        """The context in which networks compute."""
        return torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=self.settings.amp)

    def noise(self) -> torch.Generator | None:
        """Generator of the noise that breaks the auto-mask's ties in this step."""
        return torch.Generator().manual_seed(self.step) if self.settings.loss.auto_mask else None

    def _photometric(self, batch: Batch, depth_m: Tensor) -> dict[str, Tensor]:
        options = self.settings.loss
        views = []
        for index, (image, pose) in enumerate(zip(batch.source_images, batch.t_source_target, strict=True)):
            predicted = self._source_depth(batch, index) if options.geometry > 0 else None
            views.append(View(image, self.projector(depth_m, pose, batch.left), predicted))
        # Physical disparity instead of x, because the mean normalisation is meant for 1/depth.
        return supervision_parts(batch.image, 1 / depth_m, views, options, self.noise())

    @torch.no_grad()
    def _source_depth(self, batch: Batch, view: int) -> Tensor:
        """The network's depth of a source, without updating batch statistics."""
        was_training = self.network.training
        self.network.eval()
        index = batch.sources[:, view]
        range_m = self.settings.depth_range_m
        second = second_input(self.network, self.frames, index, range_m, self.device)
        disparity, _ = self.predict(batch.source_images[view], second)
        self.network.train(was_training)
        return to_depth(disparity, self.settings.depth_range_m)

    def advance(self) -> tuple[float, Batch]:
        """Performs one step and returns its loss. If that is not finite, the weights stay unchanged."""
        keep_freed_memory()
        batch = self.batches(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.learning_rate_at(self.step)
        self.network.train()
        self.optimizer.zero_grad(set_to_none=True)
        parts = self.loss_parts(batch)
        loss = total(parts)
        loss.backward()  # type: ignore[no-untyped-call]
        processes.average_gradients(self.network)
        norm = nn.utils.get_total_norm([p.grad for p in self.network.parameters() if p.grad is not None])
        value = float(processes.mean(loss.detach()))
        if not (np.isfinite(value) and torch.isfinite(norm)):
            raise _BadBatchError(batch, value)
        self.optimizer.step()
        self.step += 1
        self.parts = {name: part.detach() for name, part in parts.items()}
        return value, batch


class _BadBatchError(Exception):
    def __init__(self, batch: Batch, loss: float) -> None:
        super().__init__()
        self.batch = batch
        self.loss = loss


def train(
    trainer: Trainer,
    steps: int,
    out: Path,
    checkpoint_every: int = 200,
    on_step: Callable[[int, float], None] | None = None,
) -> Path:
    """Trains up to `steps` steps in total, continuing from a checkpoint in `out` if there is one; returns its file."""
    file = out / CHECKPOINT_FILE
    if file.exists():
        trainer.resume(checkpoints.load(file), file)
    # No process writes before all have read.
    processes.wait_for_all()
    # Writing a checkpoint now reports an unwritable disk immediately instead of after an hour.
    if not file.exists():
        _save(trainer, file)
    while trainer.step < steps:
        try:
            loss, _ = trainer.advance()
        except _BadBatchError as bad:
            where = out / BAD_BATCH_FILE
            stream = io.BytesIO()
            torch.save(bad.batch.as_dict(), stream)
            write_atomically(stream.getvalue(), where)
            raise NotFiniteError(
                f"the loss of step {trainer.step} is {bad.loss}, or its gradient not finite; "
                f"the samples are in {where}, {file} holds the last saved state; "
                "inspect the samples, or lower --learning-rate"
            ) from None
        if on_step is not None:
            on_step(trainer.step, loss)
        if trainer.step % checkpoint_every == 0 and trainer.step < steps:
            _save(trainer, file)
    _save(trainer, file)
    # A caller may close the object store, or delete the cache.
    trainer.batches.stop()
    processes.wait_for_all()
    return file


def _save(trainer: Trainer, file: Path) -> None:
    """All processes have the same weights, so one of them writes."""
    if processes.rank() == 0:
        checkpoints.save(trainer.checkpoint(), file)
