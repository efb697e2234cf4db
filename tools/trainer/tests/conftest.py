"""What tests share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def raft_small_weights() -> Path:
    """princeton-vl's published RAFT-small, beside the repository. Tests that need it skip where it is absent."""
    repository = Path(__file__).resolve().parents[3]
    for folder in repository.parents:
        file = folder / "shared/data/weights/raft-small/raft-small.pth"
        if file.is_file():
            return file
    pytest.skip("no shared/data/weights/raft-small/raft-small.pth beside the repository")
