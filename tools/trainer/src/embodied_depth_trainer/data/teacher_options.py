"""What a user says of a monocular depth network besides its file. A store's recipe holds it, and needs no PyTorch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Output = Literal["inverse", "depth"]
"""Whether a larger output is nearer (inverse depth, disparity) or farther (depth)."""

# Mean and standard deviation of ImageNet's colours, with which these networks are trained.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)
# Patch of a vision transformer (DINOv2 in Depth Anything); convolutional networks take multiples of 32.
MULTIPLE = 14


@dataclass(frozen=True)
class TeacherOptions:
    """What the file itself does not say."""

    output: Output = "inverse"
    size: tuple[int, int] | None = None
    """Rows, columns of the input; `None`: that of the file, or the frames' size rounded up to `multiple`."""
    multiple: int = MULTIPLE
    mean: tuple[float, float, float] = MEAN
    std: tuple[float, float, float] = STD
