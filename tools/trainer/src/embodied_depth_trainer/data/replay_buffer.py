"""The replay buffer: everything that the robot has recorded so far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from embodied_depth_trainer.data.coarse_depth import with_coarse
from embodied_depth_trainer.data.frames import Frames, join
from embodied_depth_trainer.data.messages import segments
from embodied_depth_trainer.data.recording import read_recording


class ReplayBuffer:
    """The frames of one run of the robot. The paper's buffer holds all 30,000 frames, and so does this one."""

    def __init__(self, run: Path, dump: Path | None) -> None:
        self.run = run
        self.dump = dump
        self.segments = 0
        self.frames: Frames | None = None

    def read(self, count: int | None = None) -> Frames:
        """Reads everything up to `count` segments, or to the end; only new segments are read from the disk."""
        new = segments(self.run)[self.segments : count]
        parts = [] if self.frames is None else [self.frames]
        for file in new:
            frames, _ = read_recording(file)
            parts.append(frames if self.dump is None else with_coarse(frames, self.dump))
        self.segments += len(new)
        joined = join(parts)
        # The segments of one run share its odometry frame.
        self.frames = replace(joined, run=np.zeros(len(joined), np.int32))
        return self.frames
