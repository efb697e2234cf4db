"""Labels from a monocular depth network that a user has downloaded as an ONNX file, such as Depth Anything or MiDaS.

The network sees one image and says depth, or inverse depth, up to a scale and a shift. These are fitted to each frame's
own labels, which come from coarse depth (`labels.py`). The teacher then says depth where the recording has none; its
confidence there is the share of the frame's labels that it agrees with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from embodied_depth_trainer.data.alignment import align
from embodied_depth_trainer.data.batches import FULL_CONFIDENCE
from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.labels import CELL, FARTHEST_M, NEAREST_M
from embodied_depth_trainer.data.teacher_options import TeacherOptions
from embodied_depth_trainer.errors import TrainerError

# A frame whose labels agree less with the teacher gets none of its depth: of those that disagree with a constant, which
# can be few, at least this share must agree with the teacher, and of all labels at least this share.
MIN_GAIN = 0.5
MIN_AGREEING = 0.6


@dataclass(frozen=True)
class Taught:
    """What the teacher added."""

    frames: int
    """Number of frames in which it agrees well enough with the labels."""
    agreeing: float
    """Mean share of the labels that it agrees with, over these frames."""
    before: float
    """Share of the cells with a label without the teacher."""
    after: float


class Teacher:
    """A monocular depth network as an ONNX file with one image as input."""

    def __init__(self, file: Path, options: TeacherOptions) -> None:
        if not file.is_file():
            raise TrainerError(f"{file} does not exist; give the ONNX file of a monocular depth network")
        try:
            self.session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        except Exception as problem:
            # The kinds of exception differ between versions of ONNX Runtime.
            raise TrainerError(f"ONNX Runtime cannot load {file}: {problem}; export the network again") from None
        self.file = file
        self.options = options
        inputs = self.session.get_inputs()
        shape = list(inputs[0].shape)
        if len(inputs) != 1 or len(shape) != 4 or inputs[0].type != "tensor(float)":
            said = ", ".join(f"{value.name} {value.type} {value.shape}" for value in inputs)
            raise TrainerError(f"{file} takes {said}, not one float32 image of 4 dimensions; give another network")
        self.name: str = inputs[0].name
        # Colours come first unless only the last dimension is 3.
        self.channels_last = shape[3] == 3 and shape[1] != 3
        rows, columns = (shape[1], shape[2]) if self.channels_last else (shape[2], shape[3])
        self.fixed = (rows, columns) if isinstance(rows, int) and isinstance(columns, int) else None

    def input_size(self, height: int, width: int) -> tuple[int, int]:
        """Rows, columns of the network's input for images of this size."""
        if self.fixed is not None:
            if self.options.size not in (None, self.fixed):
                raise TrainerError(
                    f"{self.file} takes {self.fixed[0]}x{self.fixed[1]} images only; omit --teacher-size"
                )
            return self.fixed
        multiple = self.options.multiple
        rows, columns = self.options.size or (math.ceil(s / multiple) * multiple for s in (height, width))
        return rows, columns

    def inverse_depth(self, rgb: NDArray[np.uint8]) -> NDArray[np.float64]:
        """What the network says about an image [H, W, 3], in the middle of each cell [h, w]: inverse depth up to a
        scale and a shift."""
        height, width = rgb.shape[:2]
        image = torch.from_numpy(rgb).permute(2, 0, 1)[None].float() / 255
        size = self.input_size(height, width)
        image = F.interpolate(image, size=size, mode="bicubic", align_corners=False).clamp(0, 1)
        mean, std = (torch.tensor(values).view(1, 3, 1, 1) for values in (self.options.mean, self.options.std))
        planes = (image - mean) / std
        planes = planes.permute(0, 2, 3, 1) if self.channels_last else planes
        found = self._run(planes.contiguous(), size)
        full = F.interpolate(found, size=(height, width), mode="bilinear", align_corners=False)
        x: NDArray[np.float64] = full[0, 0, CELL // 2 :: CELL, CELL // 2 :: CELL].double().numpy()
        return x if self.options.output == "inverse" else 1 / x.clip(min=1e-3)

    def _run(self, planes: Tensor, size: tuple[int, int]) -> Tensor:
        """The output as [1, 1, rows, columns]."""
        try:
            output = self.session.run(None, {self.name: planes.numpy()})[0]
        except Exception as problem:
            raise TrainerError(
                f"{self.file} fails on {size[0]}x{size[1]} images: {problem}; give --teacher-size or --teacher-multiple"
            ) from None
        plane = np.squeeze(output)
        if plane.ndim != 2:
            raise TrainerError(f"{self.file} returns {output.shape}, not one plane of depth; give another network")
        return torch.from_numpy(plane.astype(np.float32))[None, None]


def teach(frames: FrameSet, targets: NDArray[np.int64], planes: NDArray[np.uint16], teacher: Teacher) -> Taught:
    """Adds the teacher's depth to the labels [T, 2, h, w] of the frames at `targets` where they have none; existing
    labels stay."""
    before = float((planes[:, 0] > 0).mean())
    shares = []
    for target, labels in zip(targets.tolist(), planes, strict=True):
        share = _teach_frame(labels, teacher.inverse_depth(frames.rgb[target]))
        if share is not None:
            shares.append(share)
    agreeing = float(np.mean(shares)) if shares else 0.0
    return Taught(len(shares), agreeing, before, float((planes[:, 0] > 0).mean()))


def _teach_frame(planes: NDArray[np.uint16], x: NDArray[np.float64]) -> float | None:
    """Fills the empty cells of one frame's labels [2, h, w]. Returns the share of the labels that the teacher agrees
    with; `None` if it is too low to use the teacher."""
    known = planes[0] > 0
    weight = planes[1][known] / FULL_CONFIDENCE
    found = align(x[known], planes[0][known] / 1000, weight)
    if found is None or found.agreeing < max(MIN_AGREEING, found.constant + MIN_GAIN * (1 - found.constant)):
        return None
    depth_m = found.depth_m(x)
    new = ~known & (depth_m >= NEAREST_M) & (depth_m <= FARTHEST_M)
    planes[0][new] = (1000 * depth_m[new]).round().astype(np.uint16)
    planes[1][new] = round(found.agreeing * FULL_CONFIDENCE)
    return found.agreeing
