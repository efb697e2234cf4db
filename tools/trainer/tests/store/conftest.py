"""A server of S3 for the tests of this folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest

from embodied_depth_trainer.store import bucket

from ..broken_link import Address
from ..object_store import began, count_requests


@pytest.fixture
def running() -> Iterator[Any]:
    """moto's server."""
    moto = pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    yield server
    server.stop()


@pytest.fixture
def requests(running: Any) -> Counter[str]:  # noqa: ANN401
    """Counts the requests that the server answers."""
    return count_requests(running)


@pytest.fixture
def server(running: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Address]:  # noqa: ANN401
    """The address of a server of S3 without objects, which the environment names."""
    address: Address = running.get_host_and_port()
    began(address, monkeypatch)
    yield address
    bucket._store.cache_clear()
