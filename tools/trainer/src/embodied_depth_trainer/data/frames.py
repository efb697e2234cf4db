"""Frames with poses in memory: what training and evaluation work on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.errors import TrainerError


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera without distortion. Pixel centres are at integer coordinates."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def reduced(self, factor: int) -> Intrinsics:
        """Intrinsics of images in which `factor` x `factor` pixels became one."""
        if self.width % factor or self.height % factor:
            raise TrainerError(
                f"{self.height}x{self.width} images cannot be reduced {factor} times; give a factor that divides both"
            )

        return self.resized((self.height // factor, self.width // factor))

    def resized(self, size: tuple[int, int]) -> Intrinsics:
        """Intrinsics of the same view in `size` rows x columns. A pixel's left edge is at -0.5, whatever its size."""
        height, width = size
        scale_x = width / self.width
        scale_y = height / self.height
        cx = (self.cx + 0.5) * scale_x - 0.5
        cy = (self.cy + 0.5) * scale_y - 0.5
        return Intrinsics(width, height, self.fx * scale_x, self.fy * scale_y, cx, cy)


@dataclass(frozen=True)
class Frames:
    """N frames of one camera."""

    camera: Intrinsics
    rgb: NDArray[np.uint8]
    """[N, H, W, 3]."""
    t_world_camera: NDArray[np.float64]
    """[N, 4, 4]; `camera_optical` (x right, y down, z forward) in a frame that is fixed within a run, metres."""
    time_ns: NDArray[np.int64]
    run: NDArray[np.int32]
    """[N]; index of the run. Poses of different runs are not related."""
    truth_mm: NDArray[np.uint16] | None = None
    """[N, H, W]; z-depth of the ground truth, 0: none. Only the evaluation reads it."""
    coarse: NDArray[np.uint16] | None = None
    """[N, 2, H, W]; coarse z-depth in millimetres (0: none) and confidence times 65535."""
    dense: NDArray[np.uint16] | None = None
    """The same of dense depth, which the robot makes of coarse depth without a network."""
    labels: NDArray[np.uint16] | None = None
    """[N, 2, h, w]; depth labels of the middle pixel of each of h x w cells, in the same units; see `labels.py`."""
    lidar: NDArray[np.uint16] | None = None
    """[N, 2, W]; row and z-depth in millimetres (0: none) of the LiDAR's hit in each column; see `lidar_line.py`."""
    held_out: NDArray[np.bool_] | None = None
    """[N]; frames that the robot evaluates models on and that are never trained on; see `held_out.py`."""

    def __len__(self) -> int:
        return len(self.rgb)

    def every(self, step: int) -> Frames:
        """Every `step`th frame."""
        return self.at(slice(None, None, step))

    def at(self, chosen: slice) -> Frames:
        """The chosen frames."""
        arrays = {key: value for key, value in vars(self).items() if isinstance(value, np.ndarray)}
        return Frames(self.camera, **{key: value[chosen] for key, value in arrays.items()})

    def reduced(self, factor: int) -> Frames:
        """Images by the mean, depths by the most confident (coarse, dense) or the first (truth) pixel of each block:
        the mean of depths across an edge would lie between both surfaces."""
        if factor == 1:
            return self
        camera = self.camera.reduced(factor)
        blocks = self.rgb.reshape(len(self), camera.height, factor, camera.width, factor, 3)
        rgb = np.stack([image.mean(axis=(1, 3)).round().astype(np.uint8) for image in blocks])
        truth = None if self.truth_mm is None else np.ascontiguousarray(self.truth_mm[:, ::factor, ::factor])
        coarse, dense = (
            None if depth is None else np.stack([_most_confident(planes, factor) for planes in depth])
            for depth in (self.coarse, self.dense)
        )
        lidar = None if self.lidar is None else _nearest_hits(self.lidar, factor)
        return replace(self, camera=camera, rgb=rgb, truth_mm=truth, coarse=coarse, dense=dense, lidar=lidar)

    def reduced_to(self, size: tuple[int, int]) -> Frames:
        """Reduces the images to `size` rows x columns."""
        height, width = size
        factor = self.camera.height // height if height else 0
        if factor == 0 or (height * factor, width * factor) != (self.camera.height, self.camera.width):
            raise TrainerError(
                f"{self.camera.height}x{self.camera.width} images cannot become {height}x{width}; "
                "give a size that divides both by the same whole number"
            )
        return self.reduced(factor)


def _most_confident(planes: NDArray[np.uint16], factor: int) -> NDArray[np.uint16]:
    """[2, H, W] -> [2, H / factor, W / factor]."""
    _, height, width = planes.shape
    blocks = planes.reshape(2, height // factor, factor, width // factor, factor).transpose(0, 1, 3, 2, 4)
    flat = blocks.reshape(2, height // factor, width // factor, factor * factor)
    best = flat[1].argmax(axis=-1)[None, ..., None]
    return np.take_along_axis(flat, best, axis=-1)[..., 0]


def _nearest_hits(lines: NDArray[np.uint16], factor: int) -> NDArray[np.uint16]:
    """[N, 2, W] -> [N, 2, W / factor]."""
    blocks = lines.reshape(len(lines), 2, -1, factor)
    # 0 means no hit; the subtraction wraps it around to the farthest value.
    place = (blocks[:, 1:] - np.uint16(1)).argmin(axis=-1)[..., None]
    nearest: NDArray[np.uint16] = np.take_along_axis(blocks, place, axis=-1)[..., 0]
    nearest[:, 0] //= np.uint16(factor)
    return nearest


def join(parts: Sequence[Frames]) -> Frames:
    """Concatenates runs of one camera."""
    if not parts:
        raise TrainerError("no recording was given; give at least one")
    camera = parts[0].camera
    for part in parts:
        if part.camera != camera:
            raise TrainerError(f"the runs have different cameras, {camera} and {part.camera}; train on them separately")

    def all_or_none(arrays: list[NDArray[np.uint16] | None]) -> NDArray[np.uint16] | None:
        present = [array for array in arrays if array is not None]
        return np.concatenate(present) if len(present) == len(parts) else None

    def held_out(part: Frames) -> NDArray[np.bool_]:
        return np.zeros(len(part), np.bool_) if part.held_out is None else part.held_out

    first_run = np.cumsum([0, *(int(part.run.max(initial=-1)) + 1 for part in parts)])
    return Frames(
        camera,
        np.concatenate([part.rgb for part in parts]),
        np.concatenate([part.t_world_camera for part in parts]),
        np.concatenate([part.time_ns for part in parts]),
        np.concatenate([part.run + first for part, first in zip(parts, first_run, strict=False)]).astype(np.int32),
        all_or_none([part.truth_mm for part in parts]),
        all_or_none([part.coarse for part in parts]),
        all_or_none([part.dense for part in parts]),
        all_or_none([part.labels for part in parts]),
        all_or_none([part.lidar for part in parts]),
        np.concatenate([held_out(part) for part in parts]),
    )
