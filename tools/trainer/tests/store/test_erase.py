"""A run is erased with everything that was made of it, and other runs stay as they are."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.store.arrays import digest_in
from embodied_depth_trainer.store.prepare import Tools, plan, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import record

pytest.importorskip("obstore")

RECIPE = Recipe("past frames", past=PastFrames(2, 4))
TOOLS = Tools(RECIPE)


def content(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture
def pulled(tmp_path: Path) -> Path:
    """Two runs. The first segment of both is the same."""
    record(tmp_path / "pulled" / "kitchen", room(30), [14, 16])
    record(tmp_path / "pulled" / "cellar", room(40), [14, 26])
    return tmp_path / "pulled"


@pytest.fixture
def store(pulled: Path, tmp_path: Path) -> Store:
    store = Store.create(tmp_path / "store", RECIPE)
    prepare([pulled], store, TOOLS)
    return store


def erase(store: Store, run: Path | str, *options: str) -> int:
    return main(["erase", str(run), "--store", str(store.folder), *options])


def test_what_was_made_of_a_run_is_gone_and_the_other_run_can_be_trained_on(pulled: Path, store: Store) -> None:
    kitchen, cellar = store.run_of(str(pulled / "kitchen")).shards, store.run_of(str(pulled / "cellar")).shards
    assert kitchen[0].shard == cellar[0].shard
    assert erase(store, pulled / "kitchen", "--yes") == 0
    assert [run.source for run in store.runs.values()] == [str(pulled / "cellar")]
    assert not store.shard(kitchen[1].shard or "").exists()
    assert not store.labels(kitchen[1].labels or "").exists()
    # The shared shard stays. Its labels in the halo of this run do not: frames of this run have voted on them.
    assert store.shard(kitchen[0].shard or "").exists()
    assert kitchen[0].labels != cellar[0].labels
    assert not store.labels(kitchen[0].labels or "").exists()
    assert all(store.labels(entry.labels or "").exists() for entry in cellar)
    shutil.rmtree(pulled / "kitchen")
    shards, labels = plan([pulled], store, TOOLS)
    assert (shards.total, labels.total) == (0, 0)


def test_without_yes_nothing_changes(pulled: Path, store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    before = content(store.folder)
    assert erase(store, pulled / "kitchen") == 0
    assert content(store.folder) == before
    printed = capsys.readouterr()
    assert "would erase" in printed.out
    assert "give --yes" in printed.err


def test_the_receipt_has_digest_size_and_name_of_each_shard(
    pulled: Path, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    shard = store.shard(store.run_of(str(pulled / "kitchen")).shards[1].shard or "")
    expected = f"{digest_in(shard)}  {sum(file.stat().st_size for file in shard.iterdir())}  {shard}"
    shared = store.run_of(str(pulled / "kitchen")).shards[0].shard
    erase(store, pulled / "kitchen", "--yes")
    lines = capsys.readouterr().out.splitlines()
    assert expected in lines
    assert f"kept, because other runs have the same segments: {shared}" in lines
    assert any("buffer erase" in line for line in lines)
    assert lines[-1] == "erased"


def test_lists_that_trainings_have_read_are_named_and_stay(
    pulled: Path, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", "--store", str(store.folder), "--network", "student", "--batch", "2", "--steps", "1"]
    assert main([*command, "--out", str(store.folder.parent / "training")]) == 0
    (version,) = (store.folder / "datasets").iterdir()
    erase(store, pulled / "kitchen", "--yes")
    assert f"datasets/{version.name} names 1 of the erased shards" in capsys.readouterr().out
    assert version.exists()


def test_shards_of_an_earlier_state_are_named_and_erased_on_request(
    pulled: Path, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    last = store.run_of(str(pulled / "kitchen")).shards[1].shard or ""
    record(pulled / "kitchen", room(44), [14, 30], range(1, 2))
    prepare([pulled], store, TOOLS)
    assert store.shard(last).exists()
    erase(store, pulled / "kitchen", "--yes")
    assert "folders that no list names" in capsys.readouterr().out
    assert store.shard(last).exists()
    prepare([pulled], store, TOOLS)
    erase(store, pulled / "kitchen", "--unlisted", "--yes")
    assert str(store.shard(last)) in capsys.readouterr().out
    assert not store.shard(last).exists()
    assert all(store.shard(entry.shard or "").exists() for entry in store.run_of(str(pulled / "cellar")).shards)


def test_a_list_that_cannot_be_read_is_named_and_does_not_keep_a_run_from_being_erased(
    pulled: Path, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    (store.folder / "frozen").mkdir()
    (store.folder / "frozen" / "old.json").write_text("no list")
    assert erase(store, pulled / "kitchen", "--yes") == 0
    assert "not searched, because they cannot be read: frozen/old.json" in capsys.readouterr().out
    assert len(store.runs) == 1


def test_an_interrupted_call_is_repeated(pulled: Path, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    remove = shutil.rmtree

    def failing(folder: Path) -> None:
        remove(folder)
        raise PermissionError(f"{folder} is busy")

    monkeypatch.setattr("embodied_depth_trainer.store.erase.shutil.rmtree", failing)
    assert erase(store, pulled / "kitchen", "--yes") == 1
    assert len(store.runs) == 2
    monkeypatch.undo()
    assert erase(store, pulled / "kitchen", "--yes") == 0
    assert len(store.runs) == 1


def test_a_run_that_the_store_does_not_have_is_refused_with_the_way_to_list_runs(
    pulled: Path, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    before = content(store.folder)
    assert erase(store, pulled, "--yes") == 1
    assert "SELECT DISTINCT folder" in capsys.readouterr().err
    assert content(store.folder) == before


def test_the_objects_of_a_run_are_erased_and_those_of_others_are_not(pulled: Path, tmp_path: Path) -> None:
    bucket = f"file://{pulled}"
    (pulled / "kitchen" / "recording_0000.mcap.b3").write_text("digest")
    (pulled / "kitchen2").mkdir()
    (pulled / "kitchen2" / "note").write_text("the name of this run begins alike")
    store = Store.create(tmp_path / "remote", RECIPE)
    prepare([bucket], store, TOOLS)
    assert erase(store, f"{bucket}/kitchen/", "--yes") == 0
    assert not [file for file in (pulled / "kitchen").rglob("*") if file.is_file()]
    assert (pulled / "cellar" / "recording_0001.mcap").exists()
    assert (pulled / "kitchen2" / "note").exists()
    shards, labels = plan([bucket], store, TOOLS)
    assert (shards.total, labels.total) == (0, 0)


def test_a_url_that_holds_other_runs_is_refused(
    pulled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # A run whose folder has another run in it.
    shutil.copytree(pulled / "cellar", pulled / "kitchen" / "cellar")
    bucket = f"file://{pulled}"
    store = Store.create(tmp_path / "remote", RECIPE)
    prepare([bucket], store, TOOLS)
    before = content(pulled)
    assert erase(store, f"{bucket}/kitchen", "--yes") == 1
    assert "holds other runs" in capsys.readouterr().err
    assert content(pulled) == before
