"""Trains a depth network on recorded frames, without any depth sensor.

Every step draws its own randomness from (seed, step): a training that was killed goes on as if it had never stopped,
to the last bit on the CPU with the same number of threads.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from . import checkpoint as checkpoints
from . import processes
from .batches import Batch, make_batch, to_depth
from .checkpoint import Checkpoint
from .depth_networks import SIZE_STEP, build_network, output_of, takes_coarse
from .errors import TrainerError
from .frames import Frames
from .heap import keep_freed_memory
from .inputs import second_input
from .lidar_line import lidar_error
from .losses import LossOptions, View, self_supervision
from .manydepth import Disturbance, ManyDepth
from .objectives import both_ways, with_teacher
from .pairs import Pairs
from .past_frames import GAP
from .prefetch import Prefetcher
from .resnet_weights import begin_with
from .volume import volume_planes
from .warp import Projector

CHECKPOINT_FILE = "checkpoint.pt"
BAD_BATCH_FILE = "bad_batch.pt"
# Depth within 25 % of the truth is right: the field's delta1.
RIGHT = math.log(1.25)


@dataclass(frozen=True)
class Settings:
    """What shapes a training, besides frames and pairs."""

    network: str = "student"
    seed: int = 0
    batch: int = 12
    learning_rate: float = 1e-4
    depth_range_m: tuple[float, float] = (0.1, 20.0)
    augment: bool = True
    coarse_weight: float = 0.1
    """Weight of agreeing with confident coarse depth; see `coarse_error`. 0: photometric only, as in the paper."""
    label_weight: float = 0.0
    """Weight of agreeing with labels; see `label_error`."""
    lidar_weight: float = 0.0
    """Weight of agreeing with the LiDAR along its line; see `lidar_line.py`. Above 0, a depth sensor has helped."""
    uncertainty_weight: float = 0.05
    """Weight of `scale_surprise`, or of `rightness_surprise` where there are labels."""
    photometric_weight: float = 1.0
    crop_width: int = 0
    """Columns of each target that a step sees, a multiple of 32; 0: all."""
    decay: tuple[int, int] | None = None
    """The learning rate goes down to 0 along half a cosine from the first of these steps to the second."""
    teacher_steps: int = 2000
    """ManyDepth's single-frame teacher learns so long."""
    past_frames: int = 0
    """Coarse depth is from so many past frames, as the paper's is; 0: the robot's own. See `past_frames.py`."""
    past_gap: int = GAP
    encoder: str | None = None
    """What the ResNet18 that sees pictures begins with, a file or `imagenet`; `None`: random. `resnet_weights.py`."""
    amp: bool = False
    """Convolutions in bfloat16, the loss and the weights in float32."""
    loss: LossOptions = field(default_factory=LossOptions)

    def learning_rate_at(self, step: int) -> float:
        if self.decay is None:
            return self.learning_rate
        first, last = self.decay
        share = min(max((step - first) / (last - first), 0.0), 1.0)
        return self.learning_rate * 0.5 * (1 + math.cos(math.pi * share))

    def as_dict(self, frames: Frames) -> dict[str, Any]:
        """In plain types, with the camera: what a checkpoint remembers."""
        plain = asdict(self)
        plain["depth_range_m"] = list(self.depth_range_m)
        plain["decay"] = None if self.decay is None else list(self.decay)
        plain["camera"] = asdict(frames.camera)
        return plain


class NotFiniteError(TrainerError):
    """The loss or its gradient is NaN or infinite."""


class Trainer:
    """Network, optimiser and frames between two steps."""

    def __init__(self, frames: Frames, pairs: Pairs, settings: Settings, device: torch.device | str = "cpu") -> None:
        height, width = frames.camera.height, frames.camera.width
        if height % SIZE_STEP or width % SIZE_STEP:
            raise TrainerError(
                f"the networks halve five times and cannot take {height}x{width} pictures; "
                f"give --size with multiples of {SIZE_STEP}"
            )
        if settings.batch % processes.count():
            raise TrainerError(
                f"a batch of {settings.batch} cannot be shared by {processes.count()} processes; "
                "give --batch a multiple"
            )
        lost = ~np.isfinite(frames.t_world_camera).all(axis=(1, 2))
        if lost.any():
            raise TrainerError(
                f"{lost.sum()} of {len(frames)} poses are not finite, the first is {int(lost.argmax())}; leave them out"
            )
        if settings.amp and settings.network == "student":
            raise TrainerError(
                "bfloat16 is too coarse for the student's last layer and gains it little; leave --amp out"
            )
        if settings.lidar_weight > 0 and frames.lidar is None:
            raise TrainerError("the LiDAR's line is asked for, but no scans were read; give recordings, not datasets")
        self.frames, self.pairs, self.settings, self.device = frames, pairs, settings, device
        network = build_network(settings.network, settings.depth_range_m, settings.seed)
        if settings.encoder is not None:
            begin_with(network, settings.encoder)
        # Channels innermost, as the processors' convolutions want them.
        network = network.to(device).to(memory_format=torch.channels_last)
        self.network = processes.share_batch_norms(network)
        if takes_coarse(self.network) and frames.coarse is None:
            raise TrainerError(
                f"`{settings.network}` takes coarse depth; write it with `firmware-host perceive --recording RUN "
                "--out DIR --dump DIR/coarse` and give --coarse DIR/coarse, or train `monodepth2_r18`"
            )
        if settings.lidar_weight > 0 and (isinstance(self.network, ManyDepth) or settings.loss.both_ways):
            raise TrainerError(
                f"`{settings.network}` has a loss of its own, without the LiDAR; leave --lidar-weight out"
            )
        # One pass over the weights instead of a dozen.
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate, fused=True)
        self.projector = Projector(frames.camera, device)
        self.step = 0
        self.batches = Prefetcher(self.batch)

    def resume(self, saved: Checkpoint, file: Path) -> None:
        """Goes on from a checkpoint of the same settings."""
        now = self.settings.as_dict(self.frames)
        if saved.settings != now:
            different = [key for key in now if saved.settings.get(key) != now[key]]
            was = {key: saved.settings.get(key) for key in different}
            raise TrainerError(
                f"{file} was trained with {was}, now "
                f"{ {key: now[key] for key in different} } is asked for; give the same, or another --out"
            )
        self.network.load_state_dict(saved.weights)
        self.optimizer.load_state_dict(saved.optimizer)
        self.step = saved.step

    def checkpoint(self) -> Checkpoint:
        weights = {name: value.cpu() for name, value in self.network.state_dict().items()}
        settings = self.settings.as_dict(self.frames)
        return Checkpoint(self.step, self.settings.network, settings, weights, self.optimizer.state_dict())

    def batch(self, step: int) -> Batch:
        """What a step sees."""
        random = np.random.default_rng([self.settings.seed, step])
        targets, sources = self.pairs.sample(self.settings.batch, random)
        augment = random if self.settings.augment else None
        batch = make_batch(self.frames, targets, sources, self.settings.depth_range_m, augment, self.device)
        batch = self._with_volume(batch, augment) if isinstance(self.network, ManyDepth) else batch
        width = self.settings.crop_width
        if width:
            places = (self.frames.camera.width - width) // SIZE_STEP + 1
            batch = batch.cropped(SIZE_STEP * int(random.integers(places)), width)
        return batch.share(processes.rank(), processes.count())

    def _with_volume(self, batch: Batch, random: np.random.Generator | None) -> Batch:
        """With the cost volume in place of the coarse depth; disturbed at random where `random` is given."""
        assert isinstance(self.network, ManyDepth)
        disturbance = Disturbance.draw(len(batch.targets), random) if random is not None else Disturbance.none()
        planes = volume_planes(self.frames, batch.targets, self.network.depths_m, self.device, disturbance.still)
        if disturbance.empty is not None:
            planes[torch.from_numpy(disturbance.empty).to(planes.device)] = 0
        return replace(batch, coarse=planes)

    def loss(self, batch: Batch) -> Tensor:
        if isinstance(self.network, ManyDepth):
            return with_teacher(self, batch)
        if self.settings.loss.both_ways:
            return both_ways(self, batch)
        return self.loss_of(batch, *self.look(batch.seen, batch.coarse))

    def loss_of(self, batch: Batch, disparity: Tensor, log_scale: Tensor | None) -> Tensor:
        """Of what the network said."""
        settings = self.settings
        depth_m = to_depth(disparity, settings.depth_range_m)
        loss = depth_m.new_zeros(())
        if settings.photometric_weight > 0:
            loss = settings.photometric_weight * self._photometric(batch, depth_m)
        if settings.coarse_weight > 0 and self.frames.coarse is not None:
            loss = loss + settings.coarse_weight * coarse_error(depth_m, batch.coarse_whole, settings.depth_range_m)
        if settings.label_weight > 0 and batch.labels is not None:
            loss = loss + settings.label_weight * label_error(depth_m, batch.labels)
        if settings.lidar_weight > 0 and batch.lidar is not None:
            loss = loss + settings.lidar_weight * lidar_error(depth_m, batch.lidar)
        if log_scale is not None:
            if batch.labels is None:
                surprise = scale_surprise(depth_m.detach(), log_scale, batch.coarse_whole, settings.depth_range_m)
            else:
                surprise = rightness_surprise(depth_m.detach(), log_scale, batch.labels)
            loss = loss + settings.uncertainty_weight * surprise
        return loss

    def look(self, rgb: Tensor, second: Tensor) -> tuple[Tensor, Tensor | None]:
        """What the network says; see `output_of`."""
        with self.autocast():
            return output_of(self.network, rgb, second)

    def autocast(self) -> torch.autocast:
        """Where networks compute."""
        return torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=self.settings.amp)

    def noise(self) -> torch.Generator | None:
        """What breaks the auto-mask's ties in this step."""
        return torch.Generator().manual_seed(self.step) if self.settings.loss.auto_mask else None

    def _photometric(self, batch: Batch, depth_m: Tensor) -> Tensor:
        options = self.settings.loss
        views = []
        for index, (picture, pose) in enumerate(zip(batch.source_pictures, batch.t_source_target, strict=True)):
            said = self._source_depth(batch, index) if options.geometry > 0 else None
            views.append(View(picture, self.projector(depth_m, pose, batch.left), said))
        # Physical disparity, not x: the mean normalisation is meant for 1/depth.
        return self_supervision(batch.picture, 1 / depth_m, views, options, self.noise())

    @torch.no_grad()
    def _source_depth(self, batch: Batch, view: int) -> Tensor:
        """What the network says about a source; its batch statistics must not count."""
        self.network.eval()
        index, range_m = batch.sources[:, view], self.settings.depth_range_m
        second = second_input(self.network, self.frames, index, range_m, self.device)
        disparity, _ = self.look(batch.source_pictures[view], second)
        self.network.train()
        return to_depth(disparity, self.settings.depth_range_m)

    def advance(self) -> tuple[float, Batch]:
        """One step; its loss. Weights are untouched when that is not finite."""
        keep_freed_memory()
        batch = self.batches(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.learning_rate_at(self.step)
        self.network.train()
        self.optimizer.zero_grad(set_to_none=True)
        loss = self.loss(batch)
        loss.backward()  # type: ignore[no-untyped-call]
        processes.average_gradients(self.network)
        norm = nn.utils.get_total_norm([p.grad for p in self.network.parameters() if p.grad is not None])
        value = float(processes.mean(loss.detach()))
        if not (np.isfinite(value) and torch.isfinite(norm)):
            raise _BadBatchError(batch, value)
        self.optimizer.step()
        self.step += 1
        return value, batch


class _BadBatchError(Exception):
    def __init__(self, batch: Batch, loss: float) -> None:
        super().__init__()
        self.batch, self.loss = batch, loss


def coarse_error(depth_m: Tensor, coarse: Tensor, depth_range_m: tuple[float, float]) -> Tensor:
    """Mean |ln depth - ln coarse depth|, weighted with the coarse depth's confidence, also where the network was not
    shown it: several keyframes and an epipolar search know more than two neighbours' colours do. Scalar."""
    weight = coarse[:, 1:2] * coarse[:, 2:3]
    error = (depth_m.log() - to_depth(coarse[:, :1], depth_range_m).log()).abs()
    return (weight * error).sum() / processes.mean(weight.sum()).clamp(min=1.0)


def label_error(depth_m: Tensor, labels: Tensor) -> Tensor:
    """Mean |ln depth - ln label| at the middle of each labelled cell, weighted with the label's confidence. Scalar."""
    label_m, confidence = labels[:, :1], labels[:, 1:]
    error = (_at_middles(depth_m, labels).log() - label_m.clamp(min=1e-3).log()).abs()
    return (confidence * error).sum() / processes.mean(confidence.sum()).clamp(min=1.0)


def rightness_surprise(depth_m: Tensor, log_scale: Tensor, labels: Tensor) -> Tensor:
    """Mean negative log-likelihood of what the robot asks the scale for: whether the depth is right within 25 %, a
    label being the judge. Weighted with the label's confidence. Scalar."""
    label_m, confidence = labels[:, :1], labels[:, 1:]
    error = (_at_middles(depth_m, labels).log() - label_m.clamp(min=1e-3).log()).abs()
    # ln P(wrong) of a Laplacian: e^(-ln 1.25 / b).
    log_wrong = -RIGHT * torch.exp(-_at_middles(log_scale, labels))
    log_right = torch.log(-torch.expm1(log_wrong.clamp(max=-1e-6)))
    surprise = -torch.where(error < RIGHT, log_right, log_wrong)
    return (confidence * surprise).sum() / processes.mean(confidence.sum()).clamp(min=1.0)


def _at_middles(plane: Tensor, labels: Tensor) -> Tensor:
    """What `plane` [B, 1, H, W] says at the pixels that the labels [B, 2, h, w] speak of."""
    cell = plane.shape[2] // labels.shape[2]
    return plane[..., cell // 2 :: cell, cell // 2 :: cell]


def scale_surprise(depth_m: Tensor, log_scale: Tensor, coarse: Tensor, depth_range_m: tuple[float, float]) -> Tensor:
    """Mean negative log-likelihood of Laplacian errors of ln depth with the scales that the network says. Scalar.

    No sensor says the error, but coarse depth bounds it, also where the network was not shown it: |error| is at most
    the distance to the coarse depth plus the coarse depth's own error, whose scale follows from its probability to be
    right within 25 %.
    """
    valid, confidence = coarse[:, 1:2], coarse[:, 2:3].clamp(0.01, 0.999)
    distance = (depth_m.log() - to_depth(coarse[:, :1], depth_range_m).log()).abs()
    error = distance - RIGHT / torch.log1p(-confidence)
    return (valid * (error * torch.exp(-log_scale) + log_scale)).sum() / processes.mean(valid.sum()).clamp(min=1.0)


def train(
    trainer: Trainer,
    steps: int,
    out: Path,
    checkpoint_every: int = 200,
    told: Callable[[int, float], None] = lambda step, loss: None,
) -> Path:
    """Trains up to `steps` steps in all, going on from a checkpoint in `out` if there is one; the checkpoint's file."""
    file = out / CHECKPOINT_FILE
    if file.exists():
        trainer.resume(checkpoints.load(file), file)
    # Nobody writes before all have looked.
    processes.wait_for_all()
    # A disk that cannot be written shows now, not after the first hour.
    if not file.exists():
        _save(trainer, file)
    while trainer.step < steps:
        try:
            loss, _ = trainer.advance()
        except _BadBatchError as bad:
            where = out / BAD_BATCH_FILE
            stream = io.BytesIO()
            torch.save(bad.batch.as_dict(), stream)
            checkpoints.write_atomically(stream.getvalue(), where)
            raise NotFiniteError(
                f"the loss of step {trainer.step} is {bad.loss}, or its gradient not finite; "
                f"the samples are in {where}, {file} holds the last saved state; "
                "look at the samples, or lower --learning-rate"
            ) from None
        told(trainer.step, loss)
        if trainer.step % checkpoint_every == 0 and trainer.step < steps:
            _save(trainer, file)
    _save(trainer, file)
    processes.wait_for_all()
    return file


def _save(trainer: Trainer, file: Path) -> None:
    """All processes have the same weights; one writes them."""
    if processes.rank() == 0:
        checkpoints.save(trainer.checkpoint(), file)
