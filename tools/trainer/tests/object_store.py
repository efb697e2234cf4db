"""A server of S3 for tests, which counts requests."""

from __future__ import annotations

import urllib.request
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

from embodied_depth_trainer.store import bucket

from .broken_link import Address

Application = Callable[[dict[str, Any], Any], Iterable[bytes]]
BUCKET = "fleet"
ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "key",
    "AWS_SECRET_ACCESS_KEY": "secret",
    "AWS_REGION": "us-east-1",
    "AWS_ALLOW_HTTP": "true",
}


def began(address: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes a server the environment's object store, with one empty bucket."""
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    use(address, monkeypatch)
    # Servers of one process share their objects.
    request = urllib.request.Request(f"http://{address[0]}:{address[1]}/moto-api/reset", method="POST")
    urllib.request.urlopen(request).close()
    client(address).create_bucket(Bucket=BUCKET)


def use(address: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes an address the object store's."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{address[0]}:{address[1]}")
    bucket._store.cache_clear()


def client(address: Address) -> Any:  # noqa: ANN401
    import boto3

    return boto3.client("s3", endpoint_url=f"http://{address[0]}:{address[1]}", region_name="us-east-1")


def copy_to(folder: Path, below: str, address: Address) -> None:
    """Copies a folder into the bucket."""
    objects = client(address)
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        objects.put_object(Bucket=BUCKET, Key=f"{below}/{file.relative_to(folder)}", Body=file.read_bytes())


def count_requests(server: Any) -> Counter[str]:  # noqa: ANN401
    """The requests that moto's server answers from now on, by their kind."""
    counts: Counter[str] = Counter()

    def count(environment: dict[str, Any]) -> None:
        method = environment["REQUEST_METHOD"]
        is_list = method == "GET" and "list-type" in environment["QUERY_STRING"]
        counts["LIST" if is_list else method] += 1

    before_each_answer(server, count)
    return counts


def before_each_answer(server: Any, call: Callable[[dict[str, Any]], None]) -> None:  # noqa: ANN401
    """Calls a function with each request that moto's server receives from now on."""
    answer: Application = server._server.app

    def called(environment: dict[str, Any], start: Any) -> Iterable[bytes]:  # noqa: ANN401
        call(environment)
        return answer(environment, start)

    server._server.app = called
