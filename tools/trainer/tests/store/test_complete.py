"""A plan reads the lists only of those runs in which something may be missing."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import manifest
from embodied_depth_trainer.store.complete import COMPLETE_FILE
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.manifest import Run
from embodied_depth_trainer.store.prepare import Tools, plan, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import record

RECIPE = Recipe("past frames", past=PastFrames(2, 4))
TOOLS = Tools(RECIPE)
RUNS = ["one", "two", "three"]


@pytest.fixture
def pulled(tmp_path: Path) -> Path:
    """Three runs of two segments each."""
    for run in RUNS:
        record(tmp_path / "pulled" / run, room(30), [14, 16])
    return tmp_path / "pulled"


@pytest.fixture
def store(pulled: Path, tmp_path: Path) -> Store:
    """A store of the runs whose completeness is known."""
    store = Store.create(tmp_path / "store", RECIPE)
    prepare([pulled], store, TOOLS)
    assert planned(pulled, store) == (0, 0)
    return store


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The runs whose lists are read from now on."""
    found: list[str] = []
    read_run = manifest.read_run

    def counted(file: Path) -> Run:
        run = read_run(file)
        found.append(Path(run.source).name)
        return run

    monkeypatch.setattr("embodied_depth_trainer.store.store.read_run", counted)
    return found


def planned(pulled: Path, store: Store, tools: Tools = TOOLS) -> tuple[int, int]:
    """Numbers of shards and of labels that are missing."""
    shards, labels = plan([pulled], store, tools)
    return shards.total, labels.total


def test_where_nothing_has_changed_no_list_is_read(pulled: Path, store: Store, read: list[str]) -> None:
    assert planned(pulled, store) == (0, 0)
    assert read == []


def test_a_changed_segment_and_its_run_alone_are_examined_again(pulled: Path, store: Store, read: list[str]) -> None:
    os.utime(pulled / "two" / "recording_0001.mcap")
    assert planned(pulled, store) == (1, 0)
    assert read == ["two"]


def test_a_new_segment_is_planned(pulled: Path, store: Store, read: list[str]) -> None:
    record(pulled / "two", room(44), [14, 16, 14], range(2, 3))
    assert planned(pulled, store) == (1, 0)
    assert read == ["two"]


def test_a_shard_that_is_gone_is_planned_again(pulled: Path, store: Store, read: list[str]) -> None:
    # The runs are equal byte by byte, so they have the same shards.
    (entry, *_) = store.run_of(str(pulled / "one")).shards
    read.clear()
    shutil.rmtree(store.shard(entry.shard or ""))
    assert planned(pulled, store) == (3, 0)
    assert sorted(read) == sorted(RUNS)


def test_labels_that_are_gone_are_planned_again(pulled: Path, store: Store) -> None:
    (entry, *_) = store.run_of(str(pulled / "one")).shards
    shutil.rmtree(store.labels(entry.labels or ""))
    assert planned(pulled, store) == (0, 3)


def test_a_list_that_was_removed_is_made_again(pulled: Path, store: Store) -> None:
    store.run_file(str((pulled / "three").resolve())).unlink()
    assert planned(pulled, store) == (2, 0)


def test_a_list_that_was_written_again_is_read(pulled: Path, store: Store, read: list[str]) -> None:
    store.keep(store.run_of(str((pulled / "three").resolve())))
    read.clear()
    assert planned(pulled, store) == (0, 0)
    assert read == ["three"]


def test_other_robots_decide_about_all_runs(pulled: Path, store: Store, read: list[str]) -> None:
    assert planned(pulled, store, Tools(RECIPE, known_robots=KnownRobots({"0" * 64: None}))) == (6, 0)
    assert sorted(read) == sorted(RUNS)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut", b"no archive"])
def test_a_damaged_file_costs_reading_and_is_made_again(
    pulled: Path, store: Store, read: list[str], content: bytes
) -> None:
    (store.folder / COMPLETE_FILE).write_bytes(content)
    assert planned(pulled, store) == (0, 0)
    assert sorted(read) == sorted(RUNS)
    read.clear()
    assert planned(pulled, store) == (0, 0)
    assert read == []


def test_a_run_whose_last_segment_is_still_written_is_examined_each_time(
    pulled: Path, store: Store, read: list[str]
) -> None:
    record(pulled / "two", room(44), [14, 16, 14], range(2, 3))
    last = pulled / "two" / "recording_0002.mcap"
    last.write_bytes(last.read_bytes()[:-200])
    for _ in range(2):
        shards, labels = plan([pulled], store, TOOLS, growing=True)
        assert (shards.total, labels.total) == (0, 0)
    assert read == ["two", "two"]


def test_runs_of_other_sources_stay_known(pulled: Path, store: Store, read: list[str], tmp_path: Path) -> None:
    record(tmp_path / "more" / "four", room(30), [14, 16])
    prepare([tmp_path / "more"], store, TOOLS)
    assert planned(tmp_path / "more", store) == (0, 0)
    read.clear()
    assert planned(pulled, store) == (0, 0)
    assert read == []


def test_a_run_whose_oldest_segments_are_deleted_is_kept_once(pulled: Path, store: Store, read: list[str]) -> None:
    sizes = [int(np.load(store.folder / COMPLETE_FILE)["places"].size)]
    (pulled / "two" / "recording_0000.mcap").unlink()
    for _ in range(2):
        assert planned(pulled, store) == (0, 0)
        sizes.append(int(np.load(store.folder / COMPLETE_FILE)["places"].size))
    assert sizes == [3, 3, 3]
    assert read == ["two"]


def test_any_damage_of_the_file_costs_reading_only(pulled: Path, store: Store) -> None:
    file = store.folder / COMPLETE_FILE
    whole = file.read_bytes()
    random = np.random.default_rng(1)
    for _ in range(300):
        damaged = bytearray(whole)
        for place in random.integers(len(whole), size=3):
            damaged[place] ^= 1 << random.integers(8)
        file.write_bytes(damaged)
        assert planned(pulled, store) == (0, 0)


def test_processes_that_plan_at_the_same_time_do_not_disturb_each_other(pulled: Path, store: Store) -> None:
    (store.folder / COMPLETE_FILE).unlink()
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(lambda _: planned(pulled, store), range(8))) == [(0, 0)] * 8
    assert planned(pulled, store) == (0, 0)


def test_where_the_file_cannot_be_written_planning_goes_on(
    pulled: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(data: bytes, file: Path) -> None:
        raise TrainerError(f"cannot write {file}")

    monkeypatch.setattr("embodied_depth_trainer.store.complete.write_atomically", refused)
    (store.folder / COMPLETE_FILE).unlink()
    assert planned(pulled, store) == (0, 0)
