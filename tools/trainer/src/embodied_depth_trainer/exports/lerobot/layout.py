"""Names and sizes of a LeRobot dataset."""

from __future__ import annotations

from dataclasses import dataclass

IMAGE = "observation.images.front"
"""The RGB image of the camera."""
STATE = "observation.state"
"""The localized pose and the measured velocity."""
ACTION = "action"
"""The command that was sent to the base, after the safety loop has limited it."""
TIME = "time_s"
"""The real time. Not below `observation.`, because policies would take it for an observation."""

STATE_NAMES = ("x_m", "y_m", "yaw_rad", "linear_mps", "angular_radps")
ACTION_NAMES = ("linear_mps", "angular_radps")

EPISODE_FILE = "meta/episodes/chunk-000/file-000.parquet"
TASKS_FILE = "meta/tasks.parquet"

MAX_DATA_FILE = 100 << 20
"""When an episode ends and the data file is larger than this, the next episode starts a new file. LeRobot's default."""
CHUNK_FILES = 1000
"""The number of data files per directory."""
ROW_GROUP = 100
"""The number of frames in a row group, which is written from memory. `datasets` recommends this size for images."""
BREAK_NS = 1_000_000_000
"""A longer time between two images ends an episode."""


def is_step(elapsed_ns: int) -> bool:
    """Whether one image follows the other without a gap."""
    return 0 < elapsed_ns <= BREAK_NS


@dataclass(frozen=True)
class Place:
    """A data file."""

    number: int

    @property
    def chunk(self) -> int:
        return self.number // CHUNK_FILES

    @property
    def file(self) -> int:
        return self.number % CHUNK_FILES

    @property
    def path(self) -> str:
        return f"data/chunk-{self.chunk:03}/file-{self.file:03}.parquet"


@dataclass(frozen=True)
class Episode:
    """The position of an episode in the dataset: the rows from `begin` to before `end`."""

    begin: int
    end: int
    place: Place
    start_s: float
    """On the run's clock."""
