"""Segments in an object store become the same shards as on the disk, and are downloaded once."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Event

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import bucket, sources
from embodied_depth_trainer.store.bucket import StoredObject, UnreachableError, download, patience, patient_pieces
from embodied_depth_trainer.store.erase import erasure
from embodied_depth_trainer.store.prepare import Report, Tools, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store

from ..broken_link import Address, broken_link
from ..object_store import client, use
from ..rooms import room
from ..signing import KITCHEN, THIEF, public, sign, sign_run
from ..stores import calls, record, store_of, tools, without_coarse

pytest.importorskip("obstore")
pytest.importorskip("moto.server")

URL = "s3://fleet/data"
RECIPE = Recipe("none", labels=False)


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(40)


def upload(runs: Path, address: Address) -> None:
    """Uploads runs as pull-buffer does: segments, then their digests; and a marker."""
    objects = client(address)
    for file in sorted(runs.rglob("*.mcap")):
        key = f"data/{file.relative_to(runs)}"
        objects.put_object(Bucket="fleet", Key=key, Body=file.read_bytes())
        objects.put_object(Bucket="fleet", Key=f"{key}.blake3", Body=b"0" * 64)
        objects.put_object(Bucket="fleet", Key=f"{key}.pulled", Body=b"{}")


def prepared(out: Path, url: str = URL) -> tuple[Store, Report]:
    store = Store.create(out, RECIPE)
    return store, prepare([url], store, Tools(RECIPE))


def shards(store: Store) -> dict[str, bytes]:
    folder = store.folder / "shards"
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture
def downloads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The objects that are downloaded from now on."""
    found: list[str] = []

    def counted(url: str, listed: StoredObject, file: Path) -> None:
        found.append(listed.path)
        download(url, listed, file)

    monkeypatch.setattr(sources, "download", counted)
    return found


def test_a_bucket_gives_the_shards_and_labels_of_the_directory(
    walk: Frames, tmp_path: Path, robot: Path, server: Address
) -> None:
    record(tmp_path / "runs/kitchen/monday", walk, [24, 16])
    upload(tmp_path / "runs", server)
    local = store_of(tmp_path / "runs", tmp_path / "local", robot)
    remote = Store.create(tmp_path / "remote", tools(robot).recipe)
    prepare([f"{URL}/kitchen/"], remote, tools(robot, workers=2))
    assert shards(remote) == shards(local)
    (run,) = remote.runs.values()
    (same,) = local.runs.values()
    assert run.source == f"{URL}/kitchen/monday"
    assert [entry.labels for entry in run.shards] == [entry.labels for entry in same.shards]
    assert list(remote.downloads.iterdir()) == []
    assert calls(robot) == 4


def test_what_is_known_is_not_downloaded_again(
    walk: Frames, tmp_path: Path, server: Address, downloads: list[str]
) -> None:
    record(tmp_path / "runs/monday", walk, [24, 16], range(1))
    upload(tmp_path / "runs", server)
    prepared(tmp_path / "store")
    record(tmp_path / "runs/monday", walk, [24, 16], range(1, 2))
    upload(tmp_path / "runs", server)
    store, report = prepared(tmp_path / "store")
    assert (report.segments, store.frames) == (1, 40)
    assert downloads == ["monday/recording_0000.mcap", "monday/recording_0001.mcap"]
    # An object with other content replaces its shard.
    record(tmp_path / "runs/monday", room(30, seed=1), [30], range(1))
    upload(tmp_path / "runs", server)
    store, report = prepared(tmp_path / "store")
    assert (report.segments, store.frames) == (1, 46)


def test_a_listing_of_many_pages_is_complete(walk: Frames, tmp_path: Path, server: Address) -> None:
    objects = client(server)
    for number in range(1050):
        objects.put_object(Bucket="fleet", Key=f"data/run/recording_{number:04d}.mcap", Body=b"x")
    objects.put_object(Bucket="fleet", Key="data/run/recording_10000.mcap", Body=b"x")
    objects.put_object(Bucket="fleet", Key="data/run/summary.json", Body=b"{}")
    (run,) = sources.find_runs(URL)
    names = [segment.name for segment in run.segments]
    assert names == [*(f"recording_{number:04d}.mcap" for number in range(1050)), "recording_10000.mcap"]


@pytest.mark.parametrize("runs", [1, 5])
def test_requests_are_those_of_pages_and_pieces_and_no_other(
    walk: Frames, tmp_path: Path, server: Address, requests: Counter[str], monkeypatch: pytest.MonkeyPatch, runs: int
) -> None:
    monkeypatch.setattr(bucket, "PIECE", 20_000)
    for number in range(runs):
        record(tmp_path / f"runs/run_{number}", walk, [24, 16])
    upload(tmp_path / "runs", server)
    requests.clear()
    prepared(tmp_path / "store")
    sizes = [file.stat().st_size for file in (tmp_path / "runs").rglob("*.mcap")]
    assert requests == {"LIST": 1, "GET": sum(-(-size // 20_000) for size in sizes)}
    # What is known is listed only.
    requests.clear()
    prepared(tmp_path / "store")
    assert requests == {"LIST": 1}


def test_a_download_goes_on_where_the_link_broke(
    walk: Frames, tmp_path: Path, server: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "runs/monday", walk, [24, 16])
    upload(tmp_path / "runs", server)
    monkeypatch.setattr(bucket, "PIECE", 20_000)
    with broken_link(server, breaks=2, bytes_each=12_000) as link:
        use(link.address, monkeypatch)
        store, report = prepared(tmp_path / "store")
        assert link.broken == 2
    assert (report.segments, report.damaged) == (2, {})
    assert shards(store) == shards(without_coarse(tmp_path / "runs", tmp_path / "local"))


def test_a_link_that_stays_broken_is_named_and_the_next_call_completes_the_store(
    walk: Frames, tmp_path: Path, server: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "runs/monday", walk, [24, 16])
    upload(tmp_path / "runs", server)
    with broken_link(server, breaks=1000, bytes_each=12_000) as link:
        use(link.address, monkeypatch)
        with pytest.raises(TrainerError, match=rf"cannot read {URL}/monday/recording_0000\.mcap.*same command again"):
            prepared(tmp_path / "store")
    assert list((tmp_path / "store").glob("shards/*")) == []
    assert list((tmp_path / "store/downloads").iterdir()) == []
    use(server, monkeypatch)
    assert prepared(tmp_path / "store")[0].frames == 40


def test_an_interrupted_download_leaves_nothing(
    walk: Frames, tmp_path: Path, server: Address, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "runs/monday", walk, [24])
    upload(tmp_path / "runs", server)
    whole = bucket.read_part
    monkeypatch.setattr(bucket, "PIECE", 20_000)

    def interrupted(url: str, listed: StoredObject, begin: int, end: int) -> bytes:
        if begin > 0:
            raise KeyboardInterrupt
        return whole(url, listed, begin, end)

    with monkeypatch.context() as patch:
        patch.setattr(bucket, "read_part", interrupted)
        with pytest.raises(KeyboardInterrupt):
            prepared(tmp_path / "store")
    assert list((tmp_path / "store/downloads").iterdir()) == []
    assert prepared(tmp_path / "store")[0].frames == 24


@pytest.mark.parametrize("change", ["replaced", "removed"])
def test_an_object_that_changes_after_the_listing_waits_for_the_next_call(
    walk: Frames, tmp_path: Path, server: Address, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    record(tmp_path / "runs/monday", walk, [24, 16])
    upload(tmp_path / "runs", server)
    other = tmp_path / "other"
    record(other / "monday", room(30, seed=1), [30])

    def changing(url: str, listed: StoredObject, file: Path) -> None:
        if listed.path.endswith("0000.mcap"):
            if change == "replaced":
                upload(other, server)
            else:
                client(server).delete_object(Bucket="fleet", Key=f"data/{listed.path}")
        download(url, listed, file)

    with monkeypatch.context() as patch:
        patch.setattr(sources, "download", changing)
        store, report = prepared(tmp_path / "store")
    assert report.replaced == [f"{URL}/monday/recording_0000.mcap"]
    assert (report.segments, store.frames) == (1, 16)
    store, report = prepared(tmp_path / "store")
    assert report.replaced == []
    assert store.frames == (46 if change == "replaced" else 16)


def test_a_damaged_object_is_named_by_its_url(
    walk: Frames, tmp_path: Path, server: Address, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "runs/monday", walk, [24, 16])
    (tmp_path / "runs/monday/recording_0000.mcap").write_bytes(b"not a recording")
    upload(tmp_path / "runs", server)
    command = ["prepare", URL, "--out", str(tmp_path / "store"), "--coarse", "none"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert f"{URL}/monday/recording_0000.mcap" in said.err
    assert str(tmp_path / "store/downloads") not in said.err
    assert "16 frames; 2 segments were new" in said.out


def test_a_segment_that_another_person_put_into_the_bucket_trains_nothing(
    walk: Frames,
    tmp_path: Path,
    server: Address,
    downloads: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    record(tmp_path / "runs/monday", walk, [24, 8, 8])
    sign_run(tmp_path / "runs/monday", KITCHEN)
    # One segment is replaced by one that the robot did not write, and signs it with another key.
    record(tmp_path / "runs/monday", room(8, seed=1), [8], range(1))
    sign(tmp_path / "runs/monday/recording_0000.mcap", THIEF)
    # A signed segment is added under another name.
    copy = (tmp_path / "runs/monday/recording_0002.mcap").read_bytes()
    (tmp_path / "runs/monday/recording_0003.mcap").write_bytes(copy)
    upload(tmp_path / "runs", server)
    robots = tmp_path / "robots.txt"
    robots.write_text(f"{public(KITCHEN)} kitchen\n")
    command = ["prepare", URL, "--out", str(tmp_path / "store"), "--coarse", "none", "--robots", str(robots)]
    assert main(command) == 0
    said = capsys.readouterr()
    assert f"{URL}/monday/recording_0000.mcap: refused: signed by an unknown robot {public(THIEF)[:8]}" in said.err
    assert f"{URL}/monday/recording_0003.mcap: refused: is segment 2 under another name" in said.err
    assert "16 frames; 4 segments were new" in said.out
    assert len(list((tmp_path / "store/shards").iterdir())) == 2
    assert list((tmp_path / "store/downloads").iterdir()) == []
    # What was refused is known and not downloaded again.
    assert main(command) == 0
    assert len(downloads) == 4


def test_encrypted_segments_are_named_with_the_way_to_decrypt_them_and_others_are_prepared(
    walk: Frames, tmp_path: Path, server: Address, capsys: pytest.CaptureFixture[str]
) -> None:
    way = f"pull-buffer {URL} DIR --identity key.txt"
    objects = client(server)
    for number in range(2):
        objects.put_object(Bucket="fleet", Key=f"data/monday/recording_{number:04d}.mcap.age", Body=b"age")
    objects.put_object(Bucket="fleet", Key="data/monday/recording_0000.mcap.age.blake3", Body=b"0" * 64)
    with pytest.raises(TrainerError, match=r"left out: 2, such as monday/recording_0000\.mcap\.age") as error:
        prepared(tmp_path / "store")
    assert way in str(error.value)
    record(tmp_path / "runs/tuesday", walk, [24])
    upload(tmp_path / "runs", server)
    assert prepared(tmp_path / "store")[0].frames == 24
    assert way in capsys.readouterr().err


def test_a_folder_of_encrypted_runs_is_not_erased_as_one_run(walk: Frames, tmp_path: Path, server: Address) -> None:
    record(tmp_path / "runs", walk, [10])
    upload(tmp_path / "runs", server)
    store, _ = prepared(tmp_path / "store")
    client(server).put_object(Bucket="fleet", Key="data/monday/recording_0000.mcap.age", Body=b"age")
    with pytest.raises(TrainerError, match=r"holds other runs, for instance monday/recording_0000\.mcap\.age"):
        erasure(store, URL)


def test_a_bucket_that_cannot_be_read_and_one_without_segments_are_named(tmp_path: Path, server: Address) -> None:
    with pytest.raises(TrainerError, match=r"cannot read s3://nowhere/data: .*AWS_ENDPOINT_URL"):
        prepared(tmp_path / "store", "s3://nowhere/data")
    with pytest.raises(TrainerError, match=r"s3://fleet/empty holds no recording_NNNN\.mcap"):
        prepared(tmp_path / "store", "s3://fleet/empty")
    with pytest.raises(TrainerError, match="cannot read ftp://fleet/data"):
        prepared(tmp_path / "store", "ftp://fleet/data")


def test_a_run_is_erased_with_its_objects_and_markers(
    walk: Frames, tmp_path: Path, server: Address, capsys: pytest.CaptureFixture[str]
) -> None:
    for run in ("monday", "tuesday"):
        record(tmp_path / "runs/kitchen" / run, walk.at(slice(0, 20 if run == "monday" else 24)), [10])
    upload(tmp_path / "runs", server)
    store, _ = prepared(tmp_path / "store")
    assert main(["erase", f"{URL}/kitchen/monday", "--store", str(store.folder), "--yes"]) == 0
    left = [found["Key"] for found in client(server).list_objects_v2(Bucket="fleet")["Contents"]]
    assert len(left) == 3
    assert all(key.startswith("data/kitchen/tuesday/") for key in left)
    assert [run.source for run in store.runs.values()] == [f"{URL}/kitchen/tuesday"]
    assert f"{URL}/kitchen/monday/recording_0000.mcap.blake3" in capsys.readouterr().out


def test_a_download_that_waits_for_the_object_store_ends_when_the_training_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun = Event()

    def unreachable(*_: object) -> bytes:
        begun.set()
        raise UnreachableError("s3://fleet/data", OSError("connection refused"))

    monkeypatch.setattr(bucket, "read_part", unreachable)
    listed = StoredObject("rgb.npy", 10, 0, None)
    with ThreadPoolExecutor(1) as threads:
        with suppress(KeyboardInterrupt), patience():
            waiting = threads.submit(list, patient_pieces("s3://fleet/data", listed))
            begun.wait()
            raise KeyboardInterrupt
        with pytest.raises(UnreachableError):
            waiting.result(60)
