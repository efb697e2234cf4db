"""The replay buffer: all that the robot has recorded so far, read as it comes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from .coarse import with_coarse
from .frames import Frames, join
from .recording import read_recording, segments


class ReplayBuffer:
    """Frames of one run of the robot. The paper's buffer holds all 30,000, and so does this one."""

    def __init__(self, run: Path, dump: Path | None) -> None:
        self.run, self.dump = run, dump
        self.segments = 0
        self.frames: Frames | None = None

    def read(self, count: int | None = None) -> Frames:
        """Everything up to `count` segments, or to the end; only what is new is read."""
        new = segments(self.run)[self.segments : count]
        parts = [] if self.frames is None else [self.frames]
        for file in new:
            frames, _ = read_recording(file)
            parts.append(frames if self.dump is None else with_coarse(frames, self.dump))
        self.segments += len(new)
        joined = join(parts)
        # Segments of one run share its frame.
        self.frames = replace(joined, run=np.zeros(len(joined), np.int32))
        return self.frames
