"""Measures a training on a store in an object store beside one on the same store on the disk.

    python -m benchmarks.remote WORK STEPS      (in tools/trainer)

Makes a store of synthetic images of 96x320 (twelve shards of ten frames, with coarse depth and labels by stand-ins for
the robot's engine), copies it to a server of S3 on this computer, and trains the student on it: batches of 8, one
thread. Rates are per second of this process's processor time, downloads and digests included, because other programs
may run as well; the server is another process.
"""

from __future__ import annotations

import hashlib
import os
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import boto3
import torch

from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.store import bucket, remote
from embodied_depth_trainer.store.bucket import StoredObject
from embodied_depth_trainer.store.cache import Cache
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.remote import RemoteStore
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer
from tests.object_store import ENVIRONMENT
from tests.rooms import room
from tests.stores import record, robot_in, store_of

SHARDS = 12
FRAMES = 10
SETTINGS = Settings(batch=8)
URL = "s3://fleet/store"
LARGE = 10**12


def count_reads() -> Counter[str]:
    """The requests for objects and their bytes, from now on."""
    counts: Counter[str] = Counter()
    whole = bucket.read_part

    def counted(url: str, listed: StoredObject, begin: int, end: int) -> bytes:
        counts.update(gets=1, bytes=end - begin)
        return whole(url, listed, begin, end)

    # Both modules have their own name for it.
    for module in (bucket, remote):
        module.read_part = counted  # type: ignore[attr-defined]
    return counts


def serve() -> tuple[subprocess.Popen[bytes], str]:
    """A server of S3 in a process of its own."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-p", str(port)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while True:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            return server, f"http://127.0.0.1:{port}"
        except OSError:
            time.sleep(0.1)


def copy(store: Path, address: str) -> None:
    objects = boto3.client("s3", endpoint_url=address, region_name="us-east-1")
    objects.create_bucket(Bucket="fleet")
    for file in (path for path in store.rglob("*") if path.is_file()):
        objects.put_object(Bucket="fleet", Key=f"store/{file.relative_to(store)}", Body=file.read_bytes())


def measure(name: str, store: Store, steps: int, readers: int, counts: Counter[str]) -> None:
    dataset = open_dataset([store])
    pairs, _ = find_pairs(dataset, None, PairRule())
    opening = dict(counts)
    counts.clear()
    trainer = Trainer(dataset.frames, pairs, SETTINGS, readers=readers)
    # The first step allocates memory.
    trainer.advance()
    begun, wall = time.process_time(), time.perf_counter()
    for _ in range(steps):
        trainer.advance()
    used, passed = time.process_time() - begun, time.perf_counter() - wall
    weights = hashlib.sha256(b"".join(value.numpy().tobytes() for value in trainer.network.state_dict().values()))
    print(
        f"{name}, {readers} readers: {steps / used:.3f} steps per second of the processor, {steps / passed:.3f} of the "
        f"clock; opening {opening}, {steps + 1} steps and what was read ahead {dict(counts)}; weights "
        f"{weights.hexdigest()[:8]}",
        flush=True,
    )
    counts.clear()


def main() -> None:
    work, steps = Path(sys.argv[1]), int(sys.argv[2])
    torch.set_num_threads(1)
    os.environ.update(ENVIRONMENT)
    record(work / "run", room(SHARDS * FRAMES, (96, 320)), [FRAMES] * SHARDS)
    local = store_of(work / "run", work / "store", robot_in(work))
    find_pairs(open_dataset([local]), None, PairRule())
    folders = [*local.folder.glob("shards/*"), *local.folder.glob("labels/*")]
    size = sum(file.stat().st_size for folder in folders for file in folder.iterdir())
    print(f"{SHARDS} shards, {size:,} bytes", flush=True)
    server, os.environ["AWS_ENDPOINT_URL"] = serve()
    try:
        copy(local.folder, os.environ["AWS_ENDPOINT_URL"])
        counts = count_reads()
        for readers in (1, 4):
            large = Cache(work / f"large-{readers}", LARGE)
            measure("on the disk", local, steps, readers, counts)
            measure("cache that holds all, empty at first", RemoteStore(URL, large), steps, readers, counts)
            measure("on the disk", local, steps, readers, counts)
            measure("cache that holds all, filled before", RemoteStore(URL, large), steps, readers, counts)
            small = Cache(work / f"small-{readers}", 2 * size // SHARDS)
            measure("cache of two shards", RemoteStore(URL, small), steps, readers, counts)
    finally:
        server.terminate()


if __name__ == "__main__":
    main()
