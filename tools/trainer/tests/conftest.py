"""Fixtures that several tests share."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

import pytest

# The same bits on every computer: `--device auto` would use a GPU.
os.environ["CUDA_VISIBLE_DEVICES"] = ""

TRAINER = Path(__file__).resolve().parents[1]


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A program that follows the protocol of `firmware-host`; it lists its calls in `firmware-host.calls`."""
    program = tmp_path / "firmware-host"
    python = shlex.quote(sys.executable)
    program.write_text(
        f"""#!/bin/sh
if [ "$1" = --version ]; then echo firmware-host 0.0.0; exit; fi
echo "$@" >> "$0.calls"
export PYTHONPATH={TRAINER}:{TRAINER / "src"}
if [ "$1" = perceive ]; then shift; exec {python} -m tests.fake_engine "$@"; fi
exec {python} -m tests.fake_robot "$@"
"""
    )
    program.chmod(0o755)
    return program


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
