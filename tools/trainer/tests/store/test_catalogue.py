"""The table of all segments says what is in a store."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import picture
from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE, Answer, _text, query, update
from embodied_depth_trainer.store.prepare import Tools, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import record, without_coarse

duckdb = pytest.importorskip("duckdb")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    record(tmp_path / "runs/monday", room(40), [24, 16])
    record(tmp_path / "runs/it's tuesday", room(30, seed=1), [30])
    return without_coarse(tmp_path / "runs", tmp_path / "a store's folder")


def test_every_segment_is_a_row(store: Store) -> None:
    found = query(store.folder, "SELECT folder, segment, frames FROM segments ORDER BY folder, segment")
    assert found.columns == ["folder", "segment", "frames"]
    rows = [(Path(folder).name, segment, frames) for folder, segment, frames in found.rows]
    assert rows == [
        ("it's tuesday", "recording_0000.mcap", 30),
        ("monday", "recording_0000.mcap", 24),
        ("monday", "recording_0001.mcap", 16),
    ]
    ((digests, held_out),) = query(store.folder, "SELECT count(DISTINCT digest), sum(held_out) FROM segments").rows
    assert (digests, held_out >= 0) == (3, True)


def test_a_row_says_which_robot_recorded_it_and_where(store: Store, tmp_path: Path) -> None:
    identity = {"run": "5c" * 16, "boot": "3b3a", "robot": "ab" * 32, "name": "vacuum", "site": "kitchen"}
    record(tmp_path / "runs/wednesday", room(10, seed=2), [6, 4], identity=identity)
    # A robot without a key and a name.
    record(tmp_path / "runs/thursday", room(10, seed=3), [10], identity={"run": "6d" * 16, "boot": "3b3b"})
    prepare([tmp_path / "runs"], store, Tools(Recipe("none", labels=False)))
    found = query(store.folder, "SELECT DISTINCT robot, name, site, run FROM segments ORDER BY run").rows
    assert found == [
        ("ab" * 32, "vacuum", "kitchen", "5c" * 16),
        (None, None, None, "6d" * 16),
        (None, None, None, None),
    ]
    counted = query(store.folder, "SELECT name, count(*) FROM segments GROUP BY name ORDER BY name").rows
    assert counted == [("vacuum", 2), (None, 4)]


def test_a_table_of_an_earlier_version_is_written_again(store: Store) -> None:
    file = update(store.folder)
    with duckdb.connect() as database:
        database.execute(f"CREATE TABLE old AS SELECT * EXCLUDE (robot) FROM read_parquet({_text(file)})")
        database.execute(f"COPY old TO {_text(file)} (FORMAT parquet)")
    assert query(store.folder, "SELECT robot FROM segments").rows == [(None,)] * 3


def test_the_table_follows_the_store(store: Store, tmp_path: Path) -> None:
    count = "SELECT count(*), sum(frames) FROM segments"
    assert query(store.folder, count).rows == [(3, 70)]
    file = store.folder / CATALOGUE_FILE
    before = file.stat().st_mtime_ns
    assert query(store.folder, count).rows == [(3, 70)]
    assert file.stat().st_mtime_ns == before
    record(tmp_path / "runs/wednesday", room(10, seed=2), [10])
    prepare([tmp_path / "runs"], store, Tools(Recipe("none", labels=False)))
    assert query(store.folder, count).rows == [(4, 80)]


def test_a_query_that_cannot_be_answered_names_the_columns(store: Store) -> None:
    with pytest.raises(TrainerError, match=r"(?s)SELECT colour.*columns are folder, segment, robot"):
        query(store.folder, "SELECT colour FROM segments")


def test_the_command_prints_a_table(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    sql = "SELECT segment, damage, frames FROM segments WHERE frames > 25"
    assert main(["catalogue", "query", "--store", str(store.folder), sql]) == 0
    assert capsys.readouterr().out == "segment\tdamage\tframes\nrecording_0000.mcap\t\t30\n"


def test_runs_are_drawn_by_date_and_coloured_by_the_most_important_event(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        ("robots/hall/b", datetime(2026, 3, 2), 600, {"goal_chosen": 3}),
        ("robots/kitchen/a", datetime(2026, 3, 1), 500, {"goal_dropped": 2, "lost": 1}),
        ("robots/kitchen/a", datetime(2026, 3, 1, 0, 1), 100, {"goal_dropped": 2, "lost": 0}),
        ("robots/kitchen/old", None, 50, {}),
    ]
    monkeypatch.setattr(picture, "query", lambda *_: Answer(["folder", "began", "frames", "events"], rows))
    runs = picture.runs_of(store)
    assert list(runs) == ["robots/kitchen/old", "robots/kitchen/a", "robots/hall/b"]
    colors = {name: color for _, name, color in picture.EVENTS}
    assert [segment.color for segment in runs["robots/kitchen/a"]] == [colors["lost"], colors["goal dropped"]]
    assert runs["robots/hall/b"][0].color == picture.QUIET


def test_the_picture_is_the_same_for_the_same_store(
    store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / "one.png", tmp_path / "two.png"]
    for file in files:
        assert main(["catalogue", "picture", "--store", str(store.folder), "--out", str(file)]) == 0
        assert capsys.readouterr().out == f"{file}\n"
    assert files[0].read_bytes().startswith(b"\x89PNG")
    assert files[0].read_bytes() == files[1].read_bytes()
    empty = Store.create(tmp_path / "empty", Recipe("none", labels=False))
    with pytest.raises(TrainerError, match="holds no segment"):
        picture.draw(empty, tmp_path / "empty.png")
