"""Fixtures that several tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# The same bits on every computer: `--device auto` would use a GPU.
os.environ["CUDA_VISIBLE_DEVICES"] = ""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A program that follows the protocol of `firmware-host`; it lists its calls in `firmware-host.calls`."""
    from .stores import robot_in

    return robot_in(tmp_path)


@pytest.fixture
def raft_small_weights() -> Path:
    """The file of princeton-vl's published RAFT-small weights beside the repository; tests that need it are skipped
    without it."""
    repository = Path(__file__).resolve().parents[3]
    for folder in repository.parents:
        file = folder / "shared/data/weights/raft-small/raft-small.pth"
        if file.is_file():
            return file
    pytest.skip("no shared/data/weights/raft-small/raft-small.pth beside the repository")
