"""File locks. The kernel releases the lock of a process that was killed."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Refuses a second process in the same directory."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise TrainerError(f"another process works in {folder}; wait for it, or give another --out") from None
        yield


@contextmanager
def wait_for_lock(file: Path) -> Iterator[None]:
    """Waits until no other process holds this lock."""
    with file.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
