"""Writes files so that a reader sees either the old content or the complete new one, and names for unfinished ones."""

from __future__ import annotations

import os
import platform
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError


def process_name() -> str:
    """A name that no other process has, on this or another computer."""
    return f"{platform.node()}-{os.getpid()}"


def write_atomically(data: bytes, file: Path) -> None:
    """Writes `data` beside `file` and then replaces it: the old content stays until the new one is complete on the
    disk."""
    partial = file.with_name(file.name + ".partial")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, file)
    except OSError as problem:
        partial.unlink(missing_ok=True)
        kept = f"; the older {file.name} is untouched" if file.exists() else ""
        raise TrainerError(f"cannot write {file}: {problem}{kept}; free some space or give another --out") from problem
