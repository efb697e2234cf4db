"""From frames in RAM to what a step of training sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .frames import Frames

# Confidence is recorded in 16 bits.
FULL_CONFIDENCE = 65535.0
# Colours change by at most this share, hue by this share of a full turn (paper's code: ColorJitter(.2, .2, .2, .1)).
COLOR_CHANGE, HUE_CHANGE = 0.2, 0.1
# How often the picture, and how often the coarse depth, is changed.
COLOR_PROBABILITY = 0.5
NO_COARSE_PROBABILITY = 0.15
HOLE_PROBABILITY = 0.35


def rgb_planes(frames: Frames, index: NDArray[np.int64], device: torch.device | str = "cpu") -> Tensor:
    """Pictures [B, 3, H, W] in 0..1."""
    bytes_ = torch.from_numpy(frames.rgb[index]).to(device)
    return bytes_.permute(0, 3, 1, 2).to(torch.float32, memory_format=torch.contiguous_format) / 255.0


def depth_planes(planes: NDArray[np.uint16], index: NDArray[np.int64], device: torch.device | str = "cpu") -> Tensor:
    """z-depth in metres (0: none) and confidence [B, 2, h, w], as they are kept in RAM."""
    raw = torch.from_numpy(planes[index].astype(np.float32)).to(device)
    return raw / torch.tensor([1000.0, FULL_CONFIDENCE], device=device).view(1, 2, 1, 1)


def lidar_lines(lines: NDArray[np.uint16], index: NDArray[np.int64], device: torch.device | str = "cpu") -> Tensor:
    """Row and z-depth in metres (0: none) [B, 2, W]."""
    raw = torch.from_numpy(lines[index].astype(np.float32)).to(device)
    return raw * torch.tensor([1.0, 0.001], device=device).view(1, 2, 1)


def coarse_planes(
    frames: Frames, index: NDArray[np.int64], depth_range_m: tuple[float, float], device: torch.device | str = "cpu"
) -> Tensor:
    """Disparity in 0..1 over the depth range, validity and confidence [B, 3, H, W], as the robot's runtime fills them
    in."""
    batch, height, width = len(index), frames.camera.height, frames.camera.width
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
    """Metres from a network's x in 0..1."""
    near, far = depth_range_m
    return 1 / (1 / far + (1 / near - 1 / far) * disparity)


@dataclass(frozen=True)
class Batch:
    """Inputs of one step. All on one device."""

    targets: NDArray[np.int64]
    sources: NDArray[np.int64]
    """[B, S]."""
    picture: Tensor
    """Of the targets, unchanged: what the loss compares."""
    seen: Tensor
    """Of the targets, colours perhaps changed: what the network sees."""
    coarse: Tensor
    """What the network gets, holes included."""
    coarse_whole: Tensor
    """Before holes were cut."""
    labels: Tensor | None
    """z-depth in metres (0: none) and confidence of each cell's middle [B, 2, h, w]."""
    source_pictures: list[Tensor]
    """Always whole."""
    t_source_target: list[Tensor]
    """[B, 4, 4] each."""
    lidar: Tensor | None = None
    """Row and z-depth in metres (0: none) of what the LiDAR hit in each column [B, 2, W]."""
    left: int = 0
    """Column of the whole picture at which the target's planes begin."""

    def cropped(self, left: int, width: int) -> Batch:
        """`width` columns of the targets from `left` on; both are multiples of a cell. Sources stay whole."""
        across = slice(left, left + width)
        labels = self.labels
        if labels is not None:
            cell = self.picture.shape[3] // labels.shape[3]
            labels = labels[..., left // cell : (left + width) // cell]
        return replace(
            self,
            picture=self.picture[..., across],
            seen=self.seen[..., across],
            coarse=self.coarse[..., across],
            coarse_whole=self.coarse_whole[..., across],
            labels=labels,
            lidar=None if self.lidar is None else self.lidar[..., across],
            left=self.left + left,
        )

    def share(self, place: int, places: int) -> Batch:
        """Every `places`th sample from `place` on."""
        if places == 1:
            return self
        mine = slice(place, None, places)

        def of(value: Any) -> Any:  # noqa: ANN401
            if isinstance(value, list):
                return [part[mine] for part in value]
            return value if value is None or isinstance(value, int) else value[mine]

        fields: dict[str, Any] = {name: of(value) for name, value in vars(self).items()}
        return Batch(**fields)

    def as_dict(self) -> Mapping[str, Tensor | list[Tensor]]:
        """For a file that shows what went wrong."""
        return {
            "targets": torch.from_numpy(self.targets),
            "sources": torch.from_numpy(self.sources),
            "seen": self.seen.cpu(),
            "coarse": self.coarse.cpu(),
            "source_pictures": [picture.cpu() for picture in self.source_pictures],
            "t_source_target": [pose.cpu() for pose in self.t_source_target],
        }


def make_batch(
    frames: Frames,
    targets: NDArray[np.int64],
    sources: NDArray[np.int64],
    depth_range_m: tuple[float, float],
    random: np.random.Generator | None,
    device: torch.device | str = "cpu",
) -> Batch:
    """Pictures, coarse depth and poses of `targets` [B] and `sources` [B, S]; changed at random where `random` is
    given."""
    picture = rgb_planes(frames, targets, device)
    coarse = coarse_planes(frames, targets, depth_range_m, device)
    seen, holed = picture, coarse
    if random is not None:
        seen = change_colors(picture, random)
        if frames.coarse is not None:
            holed = coarse * kept_coarse(coarse.shape, random).to(device)
    poses = frames.t_world_camera
    # Rigid inverses in double precision: far from the origin, single would cost tenths of a pixel.
    inverse = np.linalg.inv(poses[sources])
    relative = (inverse @ poses[targets][:, None]).astype(np.float32)
    count = sources.shape[1]
    return Batch(
        targets,
        sources,
        picture,
        seen,
        holed,
        coarse,
        None if frames.labels is None else depth_planes(frames.labels, targets, device),
        [rgb_planes(frames, sources[:, view], device) for view in range(count)],
        [torch.from_numpy(relative[:, view].copy()).to(device) for view in range(count)],
        None if frames.lidar is None else lidar_lines(frames.lidar, targets, device),
    )


def change_colors(picture: Tensor, random: np.random.Generator) -> Tensor:
    """Brightness, contrast, saturation and hue of every second picture or so, each picture its own."""
    batch = len(picture)
    changed = random.random(batch) < COLOR_PROBABILITY
    brightness, contrast, saturation = (
        random.uniform(1 - COLOR_CHANGE, 1 + COLOR_CHANGE, (3, batch)) * changed + ~changed
    )
    angle = random.uniform(-HUE_CHANGE, HUE_CHANGE, batch) * changed * 2 * np.pi
    # Luma and two chroma axes: a hue is an angle there, a saturation a length.
    to_yiq = np.array([[0.299, 0.587, 0.114], [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
    turn = np.zeros((batch, 3, 3))
    turn[:, 0, 0] = 1
    turn[:, 1, 1] = turn[:, 2, 2] = np.cos(angle) * saturation
    turn[:, 1, 2] = -np.sin(angle) * saturation
    turn[:, 2, 1] = np.sin(angle) * saturation
    mix = np.linalg.inv(to_yiq) @ turn @ to_yiq * (brightness * contrast)[:, None, None]
    matrix = torch.from_numpy(mix.astype(np.float32)).to(picture.device)
    level = torch.from_numpy((brightness * (1 - contrast)).astype(np.float32)).to(picture.device).view(-1, 1, 1, 1)
    mean = picture.mean((1, 2, 3), keepdim=True)
    mixed = torch.einsum("bij,bjhw->bihw", matrix, picture)
    return (mixed + level * mean).clamp(0, 1)


def kept_coarse(shape: torch.Size, random: np.random.Generator) -> Tensor:
    """1 where coarse depth stays [B, 1, H, W]. Some pictures lose all of it, as after a turn on the spot, others a
    rectangle: without, a network would never learn to say depth where there is none."""
    batch, _, height, width = shape
    kept = np.ones((batch, 1, height, width), np.float32)
    for plane, chance in zip(kept, random.random(batch), strict=True):
        if chance < NO_COARSE_PROBABILITY:
            plane[:] = 0
        elif chance < NO_COARSE_PROBABILITY + HOLE_PROBABILITY:
            rows, columns = random.integers(height // 4, height + 1), random.integers(width // 8, width // 2 + 1)
            top, left = random.integers(height - rows + 1), random.integers(width - columns + 1)
            plane[:, top : top + rows, left : left + columns] = 0
    return torch.from_numpy(kept)
