"""Counts the requests of `prepare` to an object store.

    python -m benchmarks.requests WORK RUN COPIES      (in tools/trainer)

Uploads COPIES of the recorded RUN to a server of S3 on this computer, as `pull-buffer` does: beside each segment its
digest and a mark. Then prepares all of it, without coarse depth, and prints the requests.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import boto3
from moto.server import ThreadedMotoServer

from embodied_depth_trainer.store.prepare import Tools, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store
from tests.object_store import ENVIRONMENT, count_requests

RECIPE = Recipe("none", labels=False)


def upload(run: Path, copies: int, address: str) -> tuple[int, int]:
    """Returns the numbers of segments and of their bytes."""
    objects = boto3.client("s3", endpoint_url=address, region_name="us-east-1")
    objects.create_bucket(Bucket="fleet")
    segments = sorted(run.glob("recording_*.mcap"))
    for copy in range(copies):
        for file in segments:
            key = f"robot/run_{copy:04d}/{file.name}"
            objects.upload_file(str(file), "fleet", key)
            objects.put_object(Bucket="fleet", Key=f"{key}.blake3", Body=b"0" * 64)
            objects.put_object(Bucket="fleet", Key=f"{key}.pulled", Body=b"{}")
    return copies * len(segments), copies * sum(file.stat().st_size for file in segments)


def main() -> None:
    work, run, copies = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    os.environ.update(ENVIRONMENT)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    os.environ["AWS_ENDPOINT_URL"] = f"http://{host}:{port}"
    segments, size = upload(run, copies, os.environ["AWS_ENDPOINT_URL"])
    counts = count_requests(server)
    store = Store.create(work / "store", RECIPE)
    for when in ("the first time", "again, with nothing new"):
        counts.clear()
        prepare(["s3://fleet/robot"], store, Tools(RECIPE))
        per_gb = ", ".join(f"{counts[kind] / size * 1e9:.3g} {kind}" for kind in ("LIST", "GET", "HEAD", "PUT"))
        print(f"{when}: {segments} segments, {size / 1e9:.3f} GB, {dict(counts)}; per GB: {per_gb}")
    server.stop()


if __name__ == "__main__":
    main()
