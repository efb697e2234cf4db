"""What grows with a fleet's year, and what must not."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.labels import MAX_GAP
from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.store import labels as stored
from embodied_depth_trainer.store import manifest
from embodied_depth_trainer.store.arrays import ArrayFolder
from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE, query, update
from embodied_depth_trainer.store.listing import freeze, segments_of
from embodied_depth_trainer.store.manifest import Entry, Run
from embodied_depth_trainer.store.plan import UNWRITTEN, OpenRuns
from embodied_depth_trainer.store.pool import JOBS_FOR_EACH_WORKER, Processes
from embodied_depth_trainer.store.prepare import Tools, plan, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import record
from ..year import Year, make_year

pytest.importorskip("duckdb")
pytest.importorskip("cv2")

RECIPE = Recipe("past frames", past=PastFrames(2, 4))
TOOLS = Tools(RECIPE)
YEAR = Year(robots=3, runs=10, segments=20)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, list[Path]]:
    """A real store of two segments, and their recordings."""
    folder = tmp_path_factory.mktemp("real")
    record(folder / "run", room(30), [14, 16])
    store = Store.create(folder / "store", RECIPE)
    prepare([folder / "run"], store, TOOLS)
    return store, sorted((folder / "run").glob("*.mcap"))


@pytest.fixture
def year(real: tuple[Store, list[Path]], tmp_path: Path) -> tuple[Path, Store]:
    return make_year(YEAR, *real, tmp_path)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders of shards and labels that are opened from now on."""
    found: list[Path] = []
    open_folder = ArrayFolder.__init__

    def counted(self: ArrayFolder, folder: Path) -> None:
        found.append(folder)
        open_folder(self, folder)

    monkeypatch.setattr(ArrayFolder, "__init__", counted)
    return found


def test_planning_opens_no_shard_and_reads_each_list_once(
    year: tuple[Path, Store], opened: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pulled, store = year
    read: list[Path] = []
    read_run = manifest.read_run

    def counted(file: Path) -> Run:
        read.append(file)
        return read_run(file)

    monkeypatch.setattr("embodied_depth_trainer.store.store.read_run", counted)
    shards, labels = plan([pulled], store, TOOLS)
    assert (shards.total, labels.total, opened) == (0, 0, [])
    assert len(read) == len(set(read)) == YEAR.robots * YEAR.runs


def test_planning_finds_exactly_what_is_missing(year: tuple[Path, Store]) -> None:
    pulled, store = year
    runs = list(store.runs.values())
    first, second = runs[3].shards[5], runs[20].shards[0]
    store.shard(first.shard or "").unlink()
    store.labels(second.labels or "").unlink()
    shards, labels = plan([pulled], store, TOOLS)
    assert [(source, [segment.name for segment in new]) for source, new in shards] == [(runs[3].source, [first.file])]
    wanted = [(source, [file for file, _ in jobs]) for source, jobs in labels if jobs]
    assert wanted == [(runs[20].source, [second.file])]
    everything, _ = plan([pulled], Store.create(store.folder.with_name("empty"), RECIPE), TOOLS)
    assert everything.total == YEAR.total


def test_a_run_below_two_sources_is_planned_once(year: tuple[Path, Store], tmp_path: Path) -> None:
    pulled, _ = year
    empty = Store.create(tmp_path / "empty", RECIPE)
    shards, _ = plan([pulled, pulled / "robot_001"], empty, TOOLS)
    assert shards.total == YEAR.total


def test_a_query_opens_nothing_but_the_table(year: tuple[Path, Store], opened: list[Path], tmp_path: Path) -> None:
    _, store = year
    sql = """SELECT site, sum(events['safety']) FROM segments WHERE scene LIKE '%stairs=1%'
        AND began > (SELECT max(began) FROM segments) - INTERVAL 90 DAY GROUP BY site ORDER BY site"""
    first = query(store.folder, sql)
    assert len(first.rows) == 1
    assert len(opened) == YEAR.total
    opened.clear()
    assert query(store.folder, sql) == first
    # Without shards, lists and recipe.
    alone = shutil.copy(store.folder / CATALOGUE_FILE, tmp_path / "alone.parquet")
    assert query(Path(alone), sql) == first
    assert opened == []


def test_only_runs_that_changed_are_read_again(year: tuple[Path, Store], opened: list[Path]) -> None:
    _, store = year
    update(store.folder)
    opened.clear()
    grown, removed, *_ = store.runs.values()
    grown.entries.popitem()
    store.keep(grown)
    (store.folder / "runs" / f"{Run.name_of(removed.source)}.json").unlink()
    everything = "SELECT * FROM segments ORDER BY folder, segment"
    found = query(store.folder, everything)
    assert len(opened) == YEAR.segments - 1
    assert len(found.rows) == YEAR.total - YEAR.segments - 1
    # The table that is made at once is the same.
    (store.folder / CATALOGUE_FILE).unlink()
    assert query(store.folder, everything) == found


def test_a_list_that_comes_with_an_old_date_is_read(year: tuple[Path, Store], tmp_path: Path) -> None:
    _, store = year
    file = next((store.folder / "runs").glob("*.json"))
    away = shutil.move(file, tmp_path / file.name)
    count = "SELECT count(*) FROM segments"
    assert query(store.folder, count).rows == [(YEAR.total - YEAR.segments,)]
    os.utime(away, (0, 0))
    shutil.move(away, file)
    assert query(store.folder, count).rows == [(YEAR.total,)]


def test_freezing_lists_what_the_shards_say_without_opening_them(year: tuple[Path, Store], opened: list[Path]) -> None:
    _, store = year
    said = [segment.listed() for segment in segments_of(store)]
    update(store.folder)
    opened.clear()
    version = freeze(store, [shard.shard for shard in said])
    assert list(version.shards) == said
    assert opened == []


def test_what_is_missing_is_not_frozen(year: tuple[Path, Store], capsys: pytest.CaptureFixture[str]) -> None:
    _, store = year
    entries = next(iter(store.runs.values())).shards
    update(store.folder)
    store.shard(entries[0].shard or "").unlink()
    store.labels(entries[1].labels or "").unlink()
    out = store.folder.with_name("dataset.json")
    command = ["catalogue", "freeze", "--store", str(store.folder), "--out", str(out), "SELECT * FROM segments"]
    assert main(command) == 1
    said = capsys.readouterr().err
    assert "2 shards cannot be frozen" in said
    assert f"{entries[0].shard} is missing" in said
    assert f"{entries[1].file} (shard {entries[1].shard}) has no labels" in said
    assert not out.exists()


def test_a_queue_holds_a_few_jobs_for_each_worker() -> None:
    workers, jobs = 2, 50
    taken = done = 0

    def counted() -> Iterator[tuple[int, int]]:
        nonlocal taken
        for number in range(jobs):
            taken += 1
            yield number, -number

    processes = Processes(workers)
    try:
        results = {}
        for key, result in processes.results(abs, counted()):
            results[key] = result
            assert taken - done <= JOBS_FOR_EACH_WORKER * workers
            done += 1
    finally:
        processes.close()
    assert results == {number: number for number in range(jobs)}


def test_the_lists_of_a_long_run_are_written_in_proportion_to_its_segments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store.create(tmp_path, RECIPE)
    written = []
    monkeypatch.setattr(Store, "keep", lambda _, run: written.append(len(run.entries)))
    for segments in (200, 2000):
        written.clear()
        with OpenRuns(store) as lists:
            lists.begin("/run", segments)
            for number in range(segments):
                lists.done("/run", Entry(f"recording_{number:04d}.mcap", 0, 0, ""))
        assert written[-1] == segments
        # A geometric series; every write of all segments would be segments / 2 times as many.
        assert sum(written) <= (1 / UNWRITTEN + 2) * segments + 1 / UNWRITTEN**2
        assert lists.open == {}


def test_a_run_that_is_not_finished_is_written_at_the_end(tmp_path: Path) -> None:
    store = Store.create(tmp_path, RECIPE)
    with OpenRuns(store) as lists:
        lists.begin("/run", 100)
        for number in range(90):
            lists.done("/run", Entry(f"recording_{number:04d}.mcap", 0, 0, ""))
    assert len(store.run_of("/run").entries) == 90


def test_the_halo_of_a_segment_costs_the_same_in_a_run_of_any_length() -> None:
    class Counted(list[Entry]):
        def __getitem__(self, place):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN204
            assert isinstance(place, int), "a copy of the list"
            counts.append(place)
            return super().__getitem__(place)

    frames = MAX_GAP // 2
    for length in (100, 10_000):
        counts: list[int] = []
        entries = Counted(Entry(f"{n}", 0, 0, "", f"s{n}", frames) for n in range(length))
        assert stored.halo(entries, length // 2)[0] == (f"s{length // 2 - 2}", f"s{length // 2 - 1}")
        assert len(counts) == 4
