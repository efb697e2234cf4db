"""Converts frames into the tensors of one training step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from embodied_depth_trainer.data.frame_set import FrameSet, Planes

# Confidence is stored in 16 bits.
FULL_CONFIDENCE = 65535.0
# Largest relative change of colours, and of the hue as a share of a full circle (the paper's code: ColorJitter(.2, .2,
# .2, .1)).
COLOR_CHANGE = 0.2
HUE_CHANGE = 0.1
# Probabilities that the colours of a sample are jittered, that all its coarse depth is dropped, or a rectangle of it.
COLOR_PROBABILITY = 0.5
# The first of these with `color_change`.
STRONG_COLOR_PROBABILITY = 0.8
NO_COARSE_PROBABILITY = 0.15
HOLE_PROBABILITY = 0.35
# All samples of a batch.
ALL = slice(None)


def rgb_planes(frames: FrameSet, index: NDArray[np.int64], device: torch.device | str = "cpu") -> Tensor:
    """RGB images [B, 3, H, W] in 0..1."""
    raw = torch.from_numpy(frames.rgb[index]).to(device)
    return raw.permute(0, 3, 1, 2).to(torch.float32, memory_format=torch.contiguous_format) / 255.0


def depth_planes(planes: Planes[np.uint16], index: NDArray[np.int64], device: torch.device | str = "cpu") -> Tensor:
    """z-depth in metres (0: none) and confidence in 0..1, [B, 2, h, w]."""
    raw = torch.from_numpy(planes[index].astype(np.float32)).to(device)
    return raw / torch.tensor([1000.0, FULL_CONFIDENCE], device=device).view(1, 2, 1, 1)


def lidar_lines(lines: Planes[np.uint16], index: NDArray[np.int64], device: torch.device | str = "cpu") -> Tensor:
    """Row and z-depth in metres (0: none), [B, 2, W]."""
    raw = torch.from_numpy(lines[index].astype(np.float32)).to(device)
    return raw * torch.tensor([1.0, 0.001], device=device).view(1, 2, 1)


def coarse_planes(
    frames: FrameSet, index: NDArray[np.int64], depth_range_m: tuple[float, float], device: torch.device | str = "cpu"
) -> Tensor:
    """The network's coarse input [B, 3, H, W]: disparity in 0..1 over the depth range, validity and confidence,
    computed as the robot's runtime does."""
    batch = len(index)
    height = frames.camera.height
    width = frames.camera.width
    if frames.coarse is None:
        return torch.zeros(batch, 3, height, width, device=device)
    depth_m, confidence = depth_planes(frames.coarse, index, device).unbind(1)
    valid = depth_m > 0
    near, far = depth_range_m
    disparity = (1 / depth_m.clamp(min=1e-3) - 1 / far) / (1 / near - 1 / far)
    zero = torch.zeros((), device=device)
    planes = [torch.where(valid, disparity.clamp(0, 1), zero), valid.float(), torch.where(valid, confidence, zero)]
    return torch.stack(planes, 1)


def to_depth(disparity: Tensor, depth_range_m: tuple[float, float]) -> Tensor:
    """Converts a network's normalised disparity x in 0..1 to metres."""
    near, far = depth_range_m
    return 1 / (1 / far + (1 / near - 1 / far) * disparity)


@dataclass(frozen=True)
class Batch:
    """The inputs of one step, all on one device."""

    targets: NDArray[np.int64]
    sources: NDArray[np.int64]
    """[B, S]."""
    image: Tensor
    """Target images without augmentation: what the loss compares."""
    augmented: Tensor
    """Target images with jittered colours: what the network receives."""
    coarse: Tensor
    """Coarse depth with dropped parts: what the network receives."""
    coarse_full: Tensor
    """Coarse depth before parts were dropped."""
    labels: Tensor | None
    """z-depth in metres (0: none) and confidence at the middle pixel of each cell [B, 2, h, w]."""
    source_images: list[Tensor]
    """Source images, never cropped."""
    t_source_target: list[Tensor]
    """[B, 4, 4] each."""
    lidar: Tensor | None = None
    """Row and z-depth in metres (0: none) of the LiDAR's hit in each column [B, 2, W]."""
    left: int = 0
    """Column of the full image at which the crop of the target begins."""

    def cropped(self, left: int, width: int) -> Batch:
        """Crops the targets to `width` columns from `left` on, both multiples of a cell. Sources are not cropped."""
        across = slice(left, left + width)
        labels = self.labels
        if labels is not None:
            cell = self.image.shape[3] // labels.shape[3]
            labels = labels[..., left // cell : (left + width) // cell]
        return replace(
            self,
            image=self.image[..., across],
            augmented=self.augmented[..., across],
            coarse=self.coarse[..., across],
            coarse_full=self.coarse_full[..., across],
            labels=labels,
            lidar=None if self.lidar is None else self.lidar[..., across],
            left=self.left + left,
        )

    def as_dict(self) -> Mapping[str, Tensor | list[Tensor]]:
        """The content of the file that is saved when a loss is not finite."""
        return {
            "targets": torch.from_numpy(self.targets),
            "sources": torch.from_numpy(self.sources),
            "augmented": self.augmented.cpu(),
            "coarse": self.coarse.cpu(),
            "source_images": [image.cpu() for image in self.source_images],
            "t_source_target": [pose.cpu() for pose in self.t_source_target],
        }


def make_batch(
    frames: FrameSet,
    targets: NDArray[np.int64],
    sources: NDArray[np.int64],
    depth_range_m: tuple[float, float],
    random: np.random.Generator | None,
    device: torch.device | str = "cpu",
    mine: slice = ALL,
    color_change: float | None = None,
) -> Batch:
    """Builds the batch of `targets` [B] and `sources` [B, S]; augments it when `random` is given.

    Only the samples `mine` are read: the share of one process. Random numbers are drawn for all samples, so that a
    sample is the same in any number of processes. `color_change` is that of `ColorChanges.draw`.
    """
    shape = torch.Size((len(targets), 1, frames.camera.height, frames.camera.width))
    colors = ColorChanges.draw(len(targets), random, color_change) if random is not None else None
    kept = coarse_dropout_mask(shape, random) if random is not None and frames.coarse is not None else None
    targets = targets[mine]
    sources = sources[mine]
    image = rgb_planes(frames, targets, device)
    coarse = coarse_planes(frames, targets, depth_range_m, device)
    poses = frames.t_world_camera
    # Inverses in double precision: far from the origin, single precision would cost tenths of a pixel.
    inverse = np.linalg.inv(poses[sources])
    relative = (inverse @ poses[targets][:, None]).astype(np.float32)
    count = sources.shape[1]
    return Batch(
        targets,
        sources,
        image,
        image if colors is None else jitter_colors(image, colors.of(mine)),
        coarse if kept is None else coarse * kept[mine].to(device),
        coarse,
        None if frames.labels is None else depth_planes(frames.labels, targets, device),
        [rgb_planes(frames, sources[:, view], device) for view in range(count)],
        [torch.from_numpy(relative[:, view].copy()).to(device) for view in range(count)],
        None if frames.lidar is None else lidar_lines(frames.lidar, targets, device),
    )


@dataclass(frozen=True)
class ColorChanges:
    """Changes of brightness, contrast, saturation and hue of about every second image [B], each image independently."""

    level: NDArray[np.float32]
    """Added to the image, as a part of its mean [B]."""
    matrix: NDArray[np.float32]
    """Of the colours [B, 3, 3]."""

    @staticmethod
    def draw(batch: int, random: np.random.Generator, color_change: float | None = None) -> ColorChanges:
        """With `color_change`, most images change, brightness, contrast and saturation by up to this share, and hue by
        up to this share of a full circle. Without it, half of them as in the paper's code."""
        probability = COLOR_PROBABILITY if color_change is None else STRONG_COLOR_PROBABILITY
        change = COLOR_CHANGE if color_change is None else color_change
        hue_change = HUE_CHANGE if color_change is None else color_change
        changed = random.random(batch) < probability
        brightness, contrast, saturation = random.uniform(1 - change, 1 + change, (3, batch)) * changed + ~changed
        angle = random.uniform(-hue_change, hue_change, batch) * changed * 2 * np.pi
        # In YIQ (luma and two chroma axes), a hue shift is a rotation and saturation a scale.
        to_yiq = np.array([[0.299, 0.587, 0.114], [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
        rotation = np.zeros((batch, 3, 3))
        rotation[:, 0, 0] = 1
        rotation[:, 1, 1] = rotation[:, 2, 2] = np.cos(angle) * saturation
        rotation[:, 1, 2] = -np.sin(angle) * saturation
        rotation[:, 2, 1] = np.sin(angle) * saturation
        mix = np.linalg.inv(to_yiq) @ rotation @ to_yiq * (brightness * contrast)[:, None, None]
        return ColorChanges((brightness * (1 - contrast)).astype(np.float32), mix.astype(np.float32))

    def of(self, mine: slice) -> ColorChanges:
        return ColorChanges(self.level[mine], self.matrix[mine])


def jitter_colors(image: Tensor, changes: ColorChanges) -> Tensor:
    """The images [B, 3, H, W] with changed colours, in 0..1."""
    matrix = torch.from_numpy(changes.matrix).to(image.device)
    level = torch.from_numpy(changes.level).to(image.device).view(-1, 1, 1, 1)
    mean = image.mean((1, 2, 3), keepdim=True)
    mixed = torch.einsum("bij,bjhw->bihw", matrix, image)
    return (mixed + level * mean).clamp(0, 1)


def coarse_dropout_mask(shape: torch.Size, random: np.random.Generator) -> Tensor:
    """Mask [B, 1, H, W]: 1 where coarse depth is kept. Some samples lose all of it, as after a rotation on the spot,
    others a rectangle. Without this, the network would not learn to predict depth where coarse depth is missing."""
    batch, _, height, width = shape
    kept = np.ones((batch, 1, height, width), np.float32)
    for plane, chance in zip(kept, random.random(batch), strict=True):
        if chance < NO_COARSE_PROBABILITY:
            plane[:] = 0
        elif chance < NO_COARSE_PROBABILITY + HOLE_PROBABILITY:
            rows = random.integers(height // 4, height + 1)
            columns = random.integers(width // 8, width // 2 + 1)
            top = random.integers(height - rows + 1)
            left = random.integers(width - columns + 1)
            plane[:, top : top + rows, left : left + columns] = 0
    return torch.from_numpy(kept)
