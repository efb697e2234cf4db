"""Checks that a process on another computer sees the same directory."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from embodied_depth_trainer.errors import TrainerError


@contextmanager
def marked(folder: Path) -> Iterator[Path]:
    """A new directory in the folder, while the context lasts: who sees it, has the same folder."""
    mark = folder / f".ray-{uuid4().hex}"
    try:
        mark.mkdir(parents=True)
    except OSError as problem:
        raise TrainerError(f"cannot write {folder}: {problem}; free some space or give another --out") from problem
    try:
        yield mark
    finally:
        shutil.rmtree(mark, ignore_errors=True)


def check_mark(mark: Path) -> None:
    """Refuses to work in a folder that only has the same name."""
    if not mark.is_dir():
        raise TrainerError(
            f"node {platform.node()} of the Ray cluster does not see the directory {mark.parent} of this command; give "
            "an --out on a file system that all nodes mount under the same path, or use a cluster on one computer"
        )
