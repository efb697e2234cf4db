"""The rows of the data tables: collected, and written as columns, one row group at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.exports.lerobot.layout import ACTION, IMAGE, STATE, TIME, is_step
from embodied_depth_trainer.exports.lerobot.stats import Numbers, Pixels
from embodied_depth_trainer.exports.png import RgbPng
from embodied_depth_trainer.exports.ticks import Tick

Vector = NDArray[np.float32]


def state_of(tick: Tick) -> Vector | None:
    """Localized pose in `map` and measured velocity. `None` when a value is not finite."""
    pose = tick.t_map_base
    return _finite(pose.x_m, pose.y_m, pose.yaw_rad, *tick.twist)


def action_before(following: Tick) -> Vector | None:
    """The action that answered the tick before: the command that was in force when `following` began."""
    sent = following.decision and following.decision.get("sent")
    return _finite(sent["linear_mps"], sent["angular_radps"]) if sent else None


def _finite(*values: float) -> Vector | None:
    vector = np.array(values, np.float32)
    return vector if np.isfinite(vector).all() else None


@dataclass
class _Waiting:
    """The rows that are not written yet."""

    images: list[RgbPng] = field(default_factory=list)
    states: list[Vector] = field(default_factory=list)
    actions: list[Vector] = field(default_factory=list)
    times_ns: list[int] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    """Since the start of their episode."""
    frames: list[int] = field(default_factory=list)
    episodes: list[int] = field(default_factory=list)


class Rows:
    """The rows that wait, and the statistics of all rows."""

    def __init__(self) -> None:
        self.size: tuple[int, int] | None = None
        """Rows, columns of the images."""
        self.total = 0
        """The number of all rows, including those that wait."""
        self.start_ns = 0
        """The time of the first row of the episode."""
        self._frame = 0
        self._waiting = _Waiting()
        self._pixels = Pixels()
        self._numbers: dict[str, Numbers] = {}

    def fits(self, image: RgbPng) -> bool:
        """Whether an image has the same size as those before it."""
        return self.size in (None, (image.height, image.width))

    def push(self, time_ns: int, image: RgbPng, state: Vector, action: Vector, episode: int) -> None:
        self._pixels.push(image.pixels())
        self.size = image.height, image.width
        if self._frame == 0:
            self.start_ns = time_ns
        waiting = self._waiting
        waiting.images.append(image)
        waiting.states.append(state)
        waiting.actions.append(action)
        waiting.times_ns.append(time_ns)
        waiting.times_s.append((time_ns - self.start_ns) * 1e-9)
        waiting.frames.append(self._frame)
        waiting.episodes.append(episode)
        self._frame += 1
        self.total += 1

    def begin_episode(self) -> None:
        self._frame = 0

    @property
    def waiting(self) -> int:
        return len(self._waiting.images)

    @property
    def waiting_bytes(self) -> int:
        return sum(len(image.data) for image in self._waiting.images)

    def frames_per_second(self) -> int:
        """Of the rows that wait, from the mean time between images, so that nominal and real time diverge as little as
        possible."""
        steps = [step for step in np.diff(self._waiting.times_ns).tolist() if is_step(step)]
        # A single image has no rate.
        return max(1, math.floor(1e9 * len(steps) / sum(steps) + 0.5)) if steps else 10

    def write(self, fps: int, write: Callable[[dict[str, Any]], None]) -> None:
        """Passes the columns of the waiting rows to `write`, adds them to the statistics and removes them."""
        waiting, self._waiting = self._waiting, _Waiting()
        frames = np.array(waiting.frames, np.int64)
        columns: dict[str, NDArray[Any]] = {
            STATE: np.stack(waiting.states),
            ACTION: np.stack(waiting.actions),
            TIME: np.array(waiting.times_s, np.float64),
            "timestamp": (frames / fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.array(waiting.episodes, np.int64),
            "index": np.arange(self.total - len(frames), self.total, dtype=np.int64),
            "task_index": np.zeros(len(frames), np.int64),
        }
        for name, values in columns.items():
            self._numbers.setdefault(name, Numbers()).push(values)
        images = [{"bytes": image.data, "path": None} for image in waiting.images]
        write({**columns, STATE: list(columns[STATE]), ACTION: list(columns[ACTION]), IMAGE: images})

    def stats(self) -> dict[str, Any]:
        """The statistics of all rows that were written."""
        return {IMAGE: self._pixels.plain(), **{name: numbers.plain() for name, numbers in self._numbers.items()}}
