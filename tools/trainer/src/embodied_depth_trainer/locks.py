"""Who may work in a folder. A process that was killed holds no lock."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import TrainerError


@contextmanager
def the_only_one(folder: Path) -> Iterator[None]:
    """Refuses a second process in the same folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise TrainerError(f"another loop is at work in {folder}; wait for it, or give another --out") from None
        yield


@contextmanager
def wait_for_turn(file: Path) -> Iterator[None]:
    """Waits until nobody else holds this lock."""
    with file.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
