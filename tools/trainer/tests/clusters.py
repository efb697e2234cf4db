"""A small Ray cluster on this computer, for tests."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from embodied_depth_trainer.cluster import quiet

CPUS = 2
# The least that Ray accepts is about 75 MiB.
OBJECT_STORE_BYTES = 80 << 20
# One for all clusters of this process, because Ray reads it only once.
TOKEN = secrets.token_hex(32)


@contextmanager
def small_cluster() -> Iterator[None]:
    """Two worker processes; what they write is removed afterwards. Commands in this process join this cluster."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        # A token in the environment, because Ray would write a new one into the home directory.
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", TOKEN)
        # Otherwise workers leave the processor to every other program (15), and tests beside one take minutes.
        patch.setenv("RAY_worker_niceness", "0")
        patch.delenv("RAY_ADDRESS", raising=False)
        import ray

        # The names of Ray's sockets are up to 107 bytes long, and pytest's directories already have half of that.
        with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp") as folder:
            ray.init(
                "local",
                num_cpus=CPUS,
                num_gpus=0,
                include_dashboard=False,
                object_store_memory=OBJECT_STORE_BYTES,
                _temp_dir=folder,
                **quiet(ray),
            )
            try:
                yield
            finally:
                ray.shutdown()


__all__ = ["small_cluster"]
