"""A training that reads its store from an object store learns what it learns from the same store on the disk."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import bucket, remote
from embodied_depth_trainer.store.bucket import StoredObject, patient_pieces
from embodied_depth_trainer.store.cache import Cache, locked
from embodied_depth_trainer.store.dataset import Dataset, open_dataset
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.remote import RemoteStore
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..broken_link import Address
from ..object_store import BUCKET, before_each_answer, client, copy_to
from ..rooms import room
from ..stores import record, robot_in, store_of

pytest.importorskip("obstore")

URL = f"s3://{BUCKET}/store"
LARGE = 10**9
QUICK = Settings(batch=4, learning_rate=1e-3, label_weight=1.0)
STEPS = 6
COMMAND = ["train", "--batch", "4", "--steps", str(STEPS), "--checkpoint-every", "2", "--validate-every", "100"]

Weights = dict[str, Tensor]


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A store of six shards on the disk."""
    folder = tmp_path_factory.mktemp("local")
    record(folder / "run", room(96), [16] * 6)
    return store_of(folder / "run", folder / "store", robot_in(folder))


@pytest.fixture(scope="module")
def two_shards(local: Store) -> int:
    """Bytes of two of its shards with their labels."""
    folders = [*local.folder.glob("shards/*"), *local.folder.glob("labels/*")]
    return sum(file.stat().st_size for folder in folders for file in folder.iterdir()) // 3


@pytest.fixture
def copied(local: Store, server: Address) -> str:
    """The URL of a copy of it in the object store."""
    copy_to(local.folder, "store", server)
    return URL


def opened(url: str, cache: Path, limit: int = LARGE) -> Dataset:
    return open_dataset([RemoteStore(url, Cache(cache, limit))])


def learnt(dataset: Dataset, out: Path, readers: int = 1, stops: tuple[int, ...] = (STEPS,)) -> Weights:
    pairs, _ = find_pairs(dataset, None, PairRule())
    for steps in stops:
        file = train(Trainer(dataset.frames, pairs, QUICK, readers=readers), steps, out)
    return checkpoints.load(file).weights


@pytest.fixture(scope="module")
def expected(local: Store, tmp_path_factory: pytest.TempPathFactory) -> Weights:
    """What is learnt from the store on the disk."""
    return learnt(open_dataset([local]), tmp_path_factory.mktemp("expected"))


def same(one: Weights, other: Weights) -> bool:
    return all(torch.equal(one[name], other[name]) for name in one)


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}


def objects_of(array: str) -> Any:  # noqa: ANN401
    return re.compile(rf"/shards/[^/]+/{array}\.npy")


@pytest.mark.parametrize("readers", [1, 4])
@pytest.mark.parametrize("holds", ["all", "two shards"])
def test_the_weights_are_those_of_the_local_store(
    readers: int, holds: str, copied: str, expected: Weights, two_shards: int, tmp_path: Path
) -> None:
    dataset = opened(copied, tmp_path / "cache", LARGE if holds == "all" else two_shards)
    assert same(learnt(dataset, tmp_path / "out", readers), expected)
    assert not list((tmp_path / "cache").glob("files/*.partial"))


def test_a_store_in_a_folder_that_is_mounted_is_read_through_the_cache_as_well(
    local: Store, expected: Weights, tmp_path: Path
) -> None:
    dataset = opened(f"file://{local.folder}", tmp_path / "cache")
    assert same(learnt(dataset, tmp_path / "out"), expected)
    names = {file.name for file in (tmp_path / "cache/files").iterdir()}
    digests = {digest for part in dataset.parts for digest in _digests(local, part.name)}
    assert digests < names


def _digests(store: Store, shard: str) -> set[str]:
    used = store.open_shard(shard).digests
    return {used[f"{name}.npy"] for name in ("pose", "time", "held_out")}


def test_an_array_is_downloaded_when_a_batch_needs_it_and_only_once(
    copied: str, tmp_path: Path, requests: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[str] = []

    def counted(url: str, listed: StoredObject) -> Iterator[bytes]:
        found.append(listed.path)
        return patient_pieces(url, listed)

    monkeypatch.setattr(remote, "patient_pieces", counted)
    dataset = opened(copied, tmp_path / "cache")
    assert not [path for path in found if objects_of("(rgb|coarse|lidar)").search(f"/{path}")]
    dataset.frames.rgb[np.array([3, 20, 4])]
    assert sum(path.endswith("rgb.npy") for path in found) == 2
    for _ in range(2):
        dataset.frames.rgb[np.arange(len(dataset.frames))]
    assert len(found) == len(set(found))
    # The next training begins with what is there: it asks for lists and digests, and for headers of the other arrays.
    before = len(found)
    requests.clear()
    again = opened(copied, tmp_path / "cache")
    again.frames.rgb[np.arange(len(again.frames))]
    assert len(found) == before
    shards = len(again.parts)
    lists = 2
    assert requests == {"LIST": 1, "GET": lists + shards * (2 + 4)}


def test_the_cache_never_has_more_bytes_than_it_may(
    copied: str, two_shards: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    most, downloads = 0, 0

    def measured(url: str, listed: StoredObject) -> Iterator[bytes]:
        nonlocal most, downloads
        downloads += 1
        for piece in patient_pieces(url, listed):
            # No other thread changes the folder while it is measured.
            with locked(tmp_path / "cache/lock"):
                most = max(most, sum(file.stat().st_size for file in (tmp_path / "cache/files").iterdir()))
            yield piece

    monkeypatch.setattr(remote, "patient_pieces", measured)
    dataset = opened(copied, tmp_path / "cache", two_shards)
    learnt(dataset, tmp_path / "out")
    assert two_shards // 2 < most <= two_shards
    assert downloads > len(dataset.parts) * 12


def test_a_training_goes_on_when_the_object_store_was_unreachable(
    copied: str,
    expected: Weights,
    two_shards: int,
    tmp_path: Path,
    running: Any,  # noqa: ANN401
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    address = running.get_host_and_port()
    stopped = threading.Event()

    def stopping(url: str, listed: StoredObject) -> Iterator[bytes]:
        if listed.path.endswith("coarse.npy") and not stopped.is_set():
            stopped.set()
            running.stop()
            running._server.server_close()
        return patient_pieces(url, listed)

    def restart(_: float) -> None:
        """In the place of the pause before the next attempt."""
        running._port = address[1]
        running.start()

    monkeypatch.setattr(remote, "patient_pieces", stopping)
    monkeypatch.setattr(bucket, "time", SimpleNamespace(monotonic=lambda: 0.0))
    monkeypatch.setattr(bucket, "ENDING", SimpleNamespace(is_set=lambda: False, wait=restart))
    assert same(learnt(opened(copied, tmp_path / "cache", two_shards), tmp_path / "out"), expected)
    assert stopped.is_set()
    assert re.search(r"cannot read s3://\S+/coarse\.npy: .*; trying again", capsys.readouterr().err)


def test_an_object_store_that_stays_unreachable_ends_the_training_with_the_name_of_the_object(
    copied: str,
    tmp_path: Path,
    running: Any,  # noqa: ANN401
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dataset = opened(copied, tmp_path / "cache")
    running._server.app = lambda environment, start: (start("403 FORBIDDEN", []) and b"") or [b""]
    monkeypatch.setattr(bucket, "PATIENCE_S", -1.0)
    with pytest.raises(TrainerError, match=r"cannot read s3://\S+/rgb\.npy: .*the same command again"):
        dataset.frames.rgb[np.array([0])]


def test_an_object_that_was_cut_or_removed_is_named_and_left_out(
    copied: str, local: Store, server: Address, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run,) = local.runs.values()
    cut, without, *others = [entry.shard or "" for entry in run.shards]
    whole = (local.shard(cut) / "rgb.npy").read_bytes()
    client(server).put_object(Bucket=BUCKET, Key=f"store/shards/{cut}/rgb.npy", Body=whole[:-1])
    client(server).delete_object(Bucket=BUCKET, Key=f"store/shards/{without}/lidar.npy")
    dataset = opened(copied, tmp_path / "cache")
    said = capsys.readouterr().err
    assert f"left out: {URL}/shards/{cut}/rgb.npy has {len(whole) - 1} bytes" in said
    assert f"left out: {URL}/shards/{without}/lidar.npy does not exist" in said
    assert [part.name for part in dataset.parts] == others


def test_an_object_that_was_exchanged_is_named_and_left_out_from_then_on_until_it_is_right(
    copied: str, local: Store, server: Address, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run,) = local.runs.values()
    names = [entry.shard or "" for entry in run.shards]
    key = f"shards/{names[2]}/coarse.npy"
    whole = (local.folder / key).read_bytes()
    exchanged = bytearray(whole)
    exchanged[-1] ^= 4
    client(server).put_object(Bucket=BUCKET, Key=f"store/{key}", Body=bytes(exchanged))
    command = [*COMMAND, "--store", copied, "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "out")]
    assert main(command) == 1
    assert f"{URL}/{key} has the digest" in capsys.readouterr().err
    assert main(command) == 0
    assert f"left out: {URL}/{key} has the digest" in capsys.readouterr().err
    client(server).put_object(Bucket=BUCKET, Key=f"store/{key}", Body=whole)
    assert [part.name for part in opened(copied, tmp_path / "cache").parts] == names


def test_an_object_that_is_replaced_during_the_training_is_named(
    copied: str, local: Store, server: Address, tmp_path: Path
) -> None:
    dataset = opened(copied, tmp_path / "cache")
    (run,) = local.runs.values()
    key = f"shards/{run.shards[0].shard}/rgb.npy"
    other = bytes((local.folder / key).stat().st_size)
    client(server).put_object(Bucket=BUCKET, Key=f"store/{key}", Body=other)
    with pytest.raises(TrainerError, match=rf"{URL}/{key} was replaced or removed while it was read; the same command"):
        dataset.frames.rgb[np.array([0])]


def test_a_frozen_list_refuses_a_shard_whose_digests_were_exchanged_with_it(
    copied: str, local: Store, server: Address, tmp_path: Path
) -> None:
    only = open_dataset([local]).version
    (run,) = local.runs.values()
    name = run.shards[0].shard or ""
    sums = (local.shard(name) / "SHA256SUMS").read_text().replace("0", "1")
    client(server).put_object(Bucket=BUCKET, Key=f"store/shards/{name}/SHA256SUMS", Body=sums.encode())
    with pytest.raises(TrainerError, match=rf"1 of the 6 shards of dataset {only.name} cannot be used.*\n.*{name}"):
        open_dataset([RemoteStore(copied, Cache(tmp_path / "cache", LARGE))], only=only)


def test_a_frozen_list_trains_the_same_from_the_object_store(copied: str, local: Store, tmp_path: Path) -> None:
    version = open_dataset([local]).version
    read = open_dataset([RemoteStore(copied, Cache(tmp_path / "cache", LARGE))], only=version)
    assert read.version == version


def test_what_is_held_out_in_the_store_is_held_out_in_the_training(server: Address, tmp_path: Path) -> None:
    record(tmp_path / "run", room(300, (32, 64), seed=3), [100, 100, 100])
    store = store_of(tmp_path / "run", tmp_path / "store", robot_in(tmp_path), labels=False)
    copy_to(store.folder, "store", server)
    dataset = opened(URL, tmp_path / "cache")
    held = open_dataset([store]).frames.held_out
    assert 0 < held.sum() < len(held)
    assert np.array_equal(dataset.frames.held_out, held)
    pairs, _ = find_pairs(dataset, None, PairRule())
    assert not held[np.concatenate([pairs.targets, *pairs.earlier, *pairs.later])].any()


def test_pairs_that_were_copied_with_the_store_are_not_searched_again(
    local: Store, server: Address, tmp_path: Path
) -> None:
    find_pairs(open_dataset([local]), None, PairRule())
    copy_to(local.folder, "store", server)
    dataset = opened(URL, tmp_path / "cache")
    find_pairs(dataset, None, PairRule())
    (store,) = dataset.stores
    assert not (store.folder / "pairs").exists()


def test_a_file_in_the_cache_that_was_changed_is_downloaded_again(
    copied: str, local: Store, expected: Weights, tmp_path: Path
) -> None:
    learnt(opened(copied, tmp_path / "cache"), tmp_path / "first")
    for file in (tmp_path / "cache/files").iterdir():
        changed = bytearray(file.read_bytes())
        changed[-1] ^= 1
        file.write_bytes(changed)
    assert same(learnt(opened(copied, tmp_path / "cache"), tmp_path / "second"), expected)


def test_what_was_removed_from_the_object_store_is_not_trained_on_from_the_cache(
    copied: str, local: Store, server: Address, tmp_path: Path
) -> None:
    assert len(opened(copied, tmp_path / "cache").parts) == 6
    (run,) = (local.folder / "runs").iterdir()
    client(server).delete_object(Bucket=BUCKET, Key=f"store/runs/{run.name}")
    with pytest.raises(TrainerError, match="there is no shard to train on"):
        opened(copied, tmp_path / "cache")


def test_errors_say_what_to_do(copied: str, local: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [*COMMAND, "--out", str(tmp_path / "out"), "--store"]
    assert main([*command, copied]) == 1
    assert f"{URL} is read through a cache on the disk; give its folder, --cache" in capsys.readouterr().err
    cached = ["--cache", str(tmp_path / "cache")]
    assert main([*command, f"{copied}/shards", *cached]) == 1
    assert f"{URL}/shards is no store" in capsys.readouterr().err
    (run,) = local.runs.values()
    largest = max(file.stat().st_size for file in local.shard(run.shards[0].shard or "").iterdir())
    assert largest > 100_000
    assert main([*command, copied, *cached, "--cache-bytes", "100k"]) == 1
    assert f"give at least --cache-bytes {largest}" in capsys.readouterr().err
    assert main([*command, copied, *cached, "--cache-bytes", "0.5M"]) == 0
    assert "% of the files that a batch reads are downloaded again" in capsys.readouterr().err


def test_a_training_that_is_killed_in_a_download_continues_to_the_same_weights(
    copied: str,
    local: Store,
    two_shards: int,
    tmp_path: Path,
    running: Any,  # noqa: ANN401
) -> None:
    assert main([*COMMAND, "--store", str(local.folder), "--out", str(tmp_path / "local")]) == 0
    command = [sys.executable, "-m", "embodied_depth_trainer", *COMMAND, "--store", copied]
    command += ["--cache", str(tmp_path / "cache"), "--cache-bytes", str(two_shards), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=environment())

    def kill_after_a_checkpoint(request: dict[str, Any]) -> None:
        """While the object store is asked for images, and some steps are saved."""
        if objects_of("rgb").search(request["PATH_INFO"]) and _step(tmp_path / "out") >= 2:
            process.send_signal(signal.SIGKILL)
            process.wait()

    before_each_answer(running, kill_after_a_checkpoint)
    assert process.wait() == -signal.SIGKILL
    assert 2 <= _step(tmp_path / "out") < STEPS
    assert list((tmp_path / "cache/files").glob("*.partial"))
    subprocess.run(command, check=True, env=environment())
    assert same(_weights(tmp_path / "out"), _weights(tmp_path / "local"))


def test_two_ranks_share_a_cache_and_continue_after_one_was_killed(
    copied: str,
    local: Store,
    two_shards: int,
    tmp_path: Path,
    running: Any,  # noqa: ANN401
) -> None:
    together = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    together += ["-m", "embodied_depth_trainer", *COMMAND, "--readers", "2"]
    on_disk = [*together, "--store", str(local.folder), "--out", str(tmp_path / "local")]
    subprocess.run(on_disk, check=True, capture_output=True, env=environment())
    remotely = [*together, "--store", copied, "--cache", str(tmp_path / "cache"), "--cache-bytes", str(two_shards)]
    remotely += ["--out", str(tmp_path / "out")]
    process = subprocess.Popen(remotely, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment())
    killed: list[int] = []

    def kill_a_rank(request: dict[str, Any]) -> None:
        if objects_of("rgb").search(request["PATH_INFO"]) and _step(tmp_path / "out") >= 2 and not killed:
            killed.append(_children(process.pid)[-1])
            os.kill(killed[0], signal.SIGKILL)

    before_each_answer(running, kill_a_rank)
    assert process.wait() != 0
    assert killed
    assert _step(tmp_path / "out") < STEPS
    subprocess.run(remotely, check=True, capture_output=True, env=environment())
    assert same(_weights(tmp_path / "out"), _weights(tmp_path / "local"))
    assert sum(file.stat().st_size for file in (tmp_path / "cache/files").iterdir()) <= two_shards


def test_ranks_that_see_different_stores_are_refused(copied: str, local: Store, tmp_path: Path) -> None:
    shutil.copytree(local.folder, tmp_path / "smaller")
    (run,) = local.runs.values()
    shutil.rmtree(tmp_path / "smaller/shards" / (run.shards[0].shard or ""))
    script = f"""
import os
from embodied_depth_trainer.commands.cli import main
store = [{str(local.folder)!r}, {str(tmp_path / "smaller")!r}][int(os.environ["RANK"])]
raise SystemExit(main([*{COMMAND!r}, "--store", store, "--out", {str(tmp_path / "out")!r}]))
"""
    (tmp_path / "rank.py").write_text(script)
    together = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    done = subprocess.run([*together, str(tmp_path / "rank.py")], capture_output=True, text=True, env=environment())
    assert done.returncode != 0
    assert "the processes of this training read different datasets" in done.stderr


def _step(out: Path) -> int:
    """The step of the checkpoint, -1 without one."""
    file = out / "checkpoint.pt"
    return checkpoints.load(file).step if file.exists() else -1


def _weights(out: Path) -> Weights:
    return checkpoints.load(out / "checkpoint.pt").weights


def _children(process: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
