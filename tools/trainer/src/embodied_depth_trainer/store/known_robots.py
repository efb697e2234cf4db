"""The robots whose segments may be trained on: a text file with one public key in each line."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError

# The digits of a key that are enough to recognise it in a report.
SHOWN_DIGITS = 8
LINE = re.compile(r"([0-9a-f]{64})(?:\s+(\S+))?")


@dataclass(frozen=True)
class KnownRobots:
    """Robots by their public keys."""

    names: dict[str, str | None]
    """Name of each robot, by its Ed25519 public key (64 lower-case hex digits)."""

    @property
    def digest(self) -> str:
        """SHA-256 of the keys. Names, order and comments do not change which segments are accepted."""
        return hashlib.sha256("\n".join(sorted(self.names)).encode()).hexdigest()

    def label(self, key: str) -> str:
        """The name of a robot, or the first digits of its key."""
        return self.names.get(key) or shortened(key)


def shortened(key: str) -> str:
    return f"{key[:SHOWN_DIGITS]}..."


def read_robots(file: Path) -> KnownRobots:
    """The robots in a file. Empty lines and lines that begin with # are ignored."""
    try:
        lines = file.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as problem:
        raise TrainerError(
            f"cannot read {file}: {problem}; give --robots FILE with a public key in each line"
        ) from None
    names = {}
    for number, line in enumerate((line.strip() for line in lines), 1):
        if not line or line.startswith("#"):
            continue
        found = LINE.fullmatch(line)
        if found is None:
            raise TrainerError(
                f"{file}, line {number}: `{line}` is no robot; expected are the 64 lower-case hex digits of its public "
                "key and, after a space, a name without spaces"
            )
        names[found[1]] = found[2]
    if not names:
        raise TrainerError(f"{file} names no robot, so nothing would be trained on; add the public key of one")
    return KnownRobots(names)
