"""Everything besides a segment that determines its shard and its labels."""

from __future__ import annotations

import hashlib
import json
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.data.teacher_options import TeacherOptions
from embodied_depth_trainer.errors import TrainerError

FORMAT_VERSION = 2
# Length of the stretches of frames of which every second is given as by a robot that has just started.
RESTART_EVERY = 10
Coarse = Literal["robot", "past frames", "none"]


@dataclass(frozen=True)
class Recipe:
    """A store has one recipe."""

    coarse: Coarse
    """Where coarse depth comes from: the robot's own engine, past frames as in the paper, or none."""
    engine: str | None = None
    """Name and version of the robot's program."""
    past: PastFrames | None = None
    size: tuple[int, int] | None = None
    """Rows, columns that the images are reduced to; `None`: as they were recorded."""
    labels: bool = True
    teacher: str | None = None
    """SHA-256 digest of the file of a monocular network that adds labels."""
    teacher_options: TeacherOptions | None = None
    restart_every: int | None = None
    """Dense depth of every second stretch of this many frames is that of a robot that starts with the stretch; `None`:
    all of it has the memory of what the segment showed before."""

    def plain(self) -> dict[str, Any]:
        """In the types of JSON."""
        plain: dict[str, Any] = json.loads(json.dumps({"format_version": FORMAT_VERSION, **asdict(self)}))
        # Stores of before it existed keep their recipe.
        if self.restart_every is None:
            del plain["restart_every"]
        return plain

    @property
    def digest(self) -> str:
        return digest_of(self.plain())


def digest_of(plain: dict[str, Any]) -> str:
    """The digest of a recipe in the types of JSON, as in `recipe.json`."""
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def engine_of(robot: Path) -> str:
    """Name and version of the robot's program. Its coarse depth is the same as long as both are."""
    try:
        done = subprocess.run([str(robot), "--version"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as problem:
        raise TrainerError(f"`{robot} --version` failed: {problem}; give --firmware-host FILE") from None
    return done.stdout.strip()
