"""When the robot's network is trained, and for how long: the paper's schedule, scaled by one number.

The paper (Liu et al., Embodied Depth Prediction, algorithm 1) warms up with 6,000 frames, then trains after every 3,000
until there are 30,000. Passes over all frames so far are those of its released code (`embodied_depth.py`): one after
the warm-up, two before every further 3,000 frames, four in the end; 390,000 samples in all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from .errors import TrainerError

WARM_UP, EVERY, FRAMES = 6000, 3000, 30000
WARM_UP_PASSES, PASSES, LAST_PASSES = 1, 2, 4
# Fewer frames between two trainings hold next to no pair of pictures with a baseline.
LEAST_EVERY = 10


@dataclass(frozen=True)
class Round:
    """One training."""

    index: int
    frames: int
    """That the robot has recorded."""
    passes: int
    """Over all of them."""
    is_last: bool
    """The robot explores no further."""


@dataclass(frozen=True)
class Schedule:
    """All trainings of a loop. The number of steps does not depend on what the frames show, so that every policy
    trains for the same time."""

    warm_up: int
    every: int
    frames: int

    @staticmethod
    def scaled(scale: float) -> Schedule:
        """The paper's times `scale`."""
        every = round(EVERY * scale)
        if not (math.isfinite(scale) and every >= LEAST_EVERY):
            raise TrainerError(
                f"at scale {scale} the robot would be trained every {every} frames; "
                f"give --scale {LEAST_EVERY / EVERY:.3g} or more"
            )
        return Schedule(WARM_UP // EVERY * every, every, FRAMES // EVERY * every)

    def rounds(self) -> Iterator[Round]:
        for index, frames in enumerate(range(self.warm_up, self.frames + 1, self.every)):
            if frames == self.frames:
                yield Round(index, frames, LAST_PASSES, True)
            else:
                yield Round(index, frames, PASSES + (WARM_UP_PASSES if index == 0 else 0), False)

    def last_two(self) -> tuple[int, int]:
        """Of the trainings."""
        last = (self.frames - self.warm_up) // self.every
        return last - 1, last

    def steps(self, index: int, batch: int) -> int:
        """Of training, in all, when round `index` ends."""
        return sum(math.ceil(r.passes * r.frames / batch) for r in self.rounds() if r.index <= index)
