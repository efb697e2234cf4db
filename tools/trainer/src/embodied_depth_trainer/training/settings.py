"""The settings of a training."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from embodied_depth_trainer.data.frame_set import FrameSet, GivenDepth
from embodied_depth_trainer.data.past_frames import GAP
from embodied_depth_trainer.losses.reprojection import LossOptions
from embodied_depth_trainer.training.initial import identity


@dataclass(frozen=True)
class Settings:
    """Everything that determines a training, except frames and pairs. The names are part of the checkpoint format."""

    network: str = "student"
    seed: int = 0
    batch: int = 12
    learning_rate: float = 1e-4
    depth_range_m: tuple[float, float] = (0.1, 20.0)
    augment: bool = True
    color_change: float | None = None
    """Largest change of colours in the augmentation, see `ColorChanges`; `None`: that of the paper's code."""
    coarse_weight: float = 0.1
    """Weight of the agreement with the confident depth that the network is given; see `coarse_error`. 0: photometric
    only, as in the paper."""
    label_weight: float = 0.0
    """Weight of the agreement with labels; see `label_error`."""
    lidar_weight: float = 0.0
    """Weight of the agreement with the LiDAR's line; see `lidar.py`. Above 0, a depth sensor supervises."""
    uncertainty_weight: float = 0.05
    """Weight of `laplace_nll`, or of `correctness_nll` where there are labels."""
    photometric_weight: float = 1.0
    crop_width: int = 0
    """Columns of each target that a step uses, a multiple of 32; 0: all."""
    decay: tuple[int, int] | None = None
    """The learning rate falls to 0 along half a cosine from the first of these steps to the second."""
    cycle: int | None = None
    """The learning rate falls to 0 along half a cosine within this many steps, again and again (Loshchilov and Hutter
    2017), for trainings without an end."""
    teacher_steps: int = 2000
    """Number of steps for which ManyDepth's single-frame teacher is trained."""
    given_depth: GivenDepth = "coarse"
    """The depth that the network is given: the robot's coarse depth, or its dense depth."""
    past_frames: int = 0
    """Number of past frames that coarse depth is computed from, as in the paper; 0: the robot's own coarse depth. See
    `past_frames.py`."""
    past_gap: int = GAP
    encoder: str | None = None
    """Initial weights of the image encoder, a file or `imagenet`; `None`: random; see `imagenet_weights.py`."""
    init: str | None = None
    """File of the weights to go on from, a checkpoint or an ONNX file; `None`: random; see `initial.py`."""
    amp: bool = False
    """Computes convolutions in bfloat16; loss and weights stay in float32."""
    loss: LossOptions = field(default_factory=LossOptions)

    @property
    def needs_sources(self) -> bool:
        """Whether the loss or the network looks at other frames than the target."""
        return self.photometric_weight > 0 or self.loss.both_ways or self.network == "manydepth_r18"

    def learning_rate_at(self, step: int) -> float:
        if self.decay is not None:
            first, last = self.decay
            share = min(max((step - first) / (last - first), 0.0), 1.0)
        elif self.cycle is not None:
            share = step % self.cycle / self.cycle
        else:
            return self.learning_rate
        return self.learning_rate * 0.5 * (1 + math.cos(math.pi * share))

    def as_dict(self, frames: FrameSet) -> dict[str, Any]:
        """In plain types and with the camera, as checkpoints store it."""
        plain = asdict(self)
        plain["depth_range_m"] = list(self.depth_range_m)
        plain["decay"] = None if self.decay is None else list(self.decay)
        plain["camera"] = asdict(frames.camera)
        plain["init"] = identity(self.init)
        return plain
