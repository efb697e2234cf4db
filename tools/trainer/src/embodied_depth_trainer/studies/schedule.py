"""When the robot's network is trained and for how long: the paper's schedule, multiplied by a scale.

The paper (Liu et al., Embodied Depth Prediction, algorithm 1) warms up with 6,000 frames, then trains after every
3,000 until there are 30,000. The numbers of passes over all frames so far are those of its released code
(`embodied_depth.py`): one after the warm-up, two before every further 3,000 frames, four at the end; 390,000 samples
in total.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from embodied_depth_trainer.errors import TrainerError

WARM_UP = 6000
EVERY = 3000
FRAMES = 30000
WARM_UP_PASSES = 1
PASSES = 2
LAST_PASSES = 4
# Fewer frames between two trainings contain hardly any pair of frames with a baseline.
MIN_EVERY = 10


@dataclass(frozen=True)
class Round:
    """One training."""

    index: int
    frames: int
    """Number of frames that the robot has recorded."""
    passes: int
    """Passes over all recorded frames."""
    is_last: bool
    """After this training the robot does not explore any further."""


@dataclass(frozen=True)
class Schedule:
    """All trainings of a loop. The number of steps does not depend on the content of the frames, so every policy
    trains equally long."""

    warm_up: int
    every: int
    frames: int

    @staticmethod
    def scaled(scale: float) -> Schedule:
        """The paper's schedule times `scale`."""
        every = round(EVERY * scale)
        if not (math.isfinite(scale) and every >= MIN_EVERY):
            raise TrainerError(
                f"at scale {scale} the robot would be trained every {every} frames; "
                f"give --scale {MIN_EVERY / EVERY:.3g} or more"
            )
        return Schedule(WARM_UP // EVERY * every, every, FRAMES // EVERY * every)

    def rounds(self) -> Iterator[Round]:
        for index, frames in enumerate(range(self.warm_up, self.frames + 1, self.every)):
            if frames == self.frames:
                yield Round(index, frames, LAST_PASSES, True)
            else:
                yield Round(index, frames, PASSES + (WARM_UP_PASSES if index == 0 else 0), False)

    def last_two(self) -> tuple[int, int]:
        """The indices of the last two trainings."""
        last = (self.frames - self.warm_up) // self.every
        return last - 1, last

    def steps(self, index: int, batch: int) -> int:
        """Total training steps at the end of round `index`."""
        return sum(math.ceil(r.passes * r.frames / batch) for r in self.rounds() if r.index <= index)
