"""With `--robots`, nothing is trained on that no known robot signed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import shards
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.manifest import Entry
from embodied_depth_trainer.store.prepare import Report, Tools, prepare, prune
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.trust import NOT_CHECKED, checked

from ..rooms import room
from ..signing import HALL, KITCHEN, ROBOTS, THIEF, public, sign, sign_run
from ..stores import calls, record, tools

RECIPE = Recipe("none", labels=False)
NO_ROBOT_OF_OURS = KnownRobots({"00" * 32: "another"})


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(40, (16, 32))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return tmp_path / "run"


def prepared(tmp_path: Path, robots: KnownRobots | None = ROBOTS) -> tuple[Store, Report]:
    """The store of the run, as another process finds it."""
    store = Store.create(tmp_path / "store", RECIPE)
    report = prepare([tmp_path / "run"], store, Tools(RECIPE, known_robots=robots))
    return Store(store.folder), report


def listed(store: Store) -> list[str]:
    """The files whose shards trainings read."""
    return [entry.file for run in store.runs.values() for entry in run.shards]


def looked_at(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The segments that are checked from now on."""
    found: list[str] = []

    def counted(entry: Entry, file: Path, robots: KnownRobots) -> Entry:
        found.append(entry.file)
        return checked(entry, file, robots)

    monkeypatch.setattr(shards, "checked", counted)
    return found


def test_only_what_a_known_robot_signed_has_a_shard(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8, 8, 8, 8])
    sign(run / "recording_0000.mcap", KITCHEN)
    sign(run / "recording_0001.mcap", THIEF)
    sign(run / "recording_0003.mcap", HALL)
    changed = bytearray((run / "recording_0003.mcap").read_bytes())
    changed[1000] ^= 1
    (run / "recording_0003.mcap").write_bytes(changed)
    store, report = prepared(tmp_path)
    assert listed(store) == ["recording_0000.mcap"]
    assert len(list(store.folder.glob("shards/*"))) == 1
    assert report.refused == {
        f"{run}/recording_0001.mcap": f"signed by an unknown robot {public(THIEF)[:8]}...",
        f"{run}/recording_0002.mcap": "unsigned",
        f"{run}/recording_0003.mcap": "changed since it was signed",
    }
    assert report.signed_by == {public(KITCHEN): 1}


def test_without_known_robots_signatures_are_not_checked(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8, 8])
    sign(run / "recording_0000.mcap", THIEF)
    store, report = prepared(tmp_path, None)
    assert len(listed(store)) == 2
    assert report.refused == {}


def test_workers_check_as_one_process_does(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8, 8])
    sign(run / "recording_0001.mcap", KITCHEN)
    store = Store.create(tmp_path / "store", RECIPE)
    report = prepare([run], store, Tools(RECIPE, workers=2, known_robots=ROBOTS))
    assert listed(store) == ["recording_0001.mcap"]
    assert report.refused == {f"{run}/recording_0000.mcap": "unsigned"}


def test_a_refused_segment_is_looked_at_again_only_with_other_robots(
    walk: Frames, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(run, walk, [8, 8])
    sign(run / "recording_0000.mcap", KITCHEN)
    sign(run / "recording_0001.mcap", THIEF)
    prepared(tmp_path)
    found = looked_at(monkeypatch)
    store, report = prepared(tmp_path)
    assert (found, report.segments, report.refused, store.refused) == ([], 0, {}, 1)
    prepared(tmp_path, KnownRobots({**ROBOTS.names, public(THIEF): "found again"}))
    assert found == ["recording_0001.mcap"]
    assert len(listed(prepared(tmp_path)[0])) == 1
    # Without the option, everything is accepted.
    assert len(listed(prepared(tmp_path, None)[0])) == 2


def test_a_refused_segment_that_is_replaced_is_looked_at_again(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8])
    assert listed(prepared(tmp_path)[0]) == []
    sign(run / "recording_0000.mcap", KITCHEN)
    assert listed(prepared(tmp_path)[0]) == ["recording_0000.mcap"]


def test_a_shard_that_was_made_without_a_check_does_not_slip_through(
    walk: Frames, run: Path, tmp_path: Path, robot: Path
) -> None:
    frames = room(40)
    record(run, frames, [16, 16, 8])
    sign(run / "recording_0000.mcap", KITCHEN)
    store = Store.create(tmp_path / "store", tools(robot).recipe)
    prepare([run], store, tools(robot))
    before = [entry.labels for entry in next(iter(store.runs.values())).shards]
    assert (store.frames, calls(robot)) == (40, 3)
    (run / "recording_0002.mcap").unlink()
    report = prepare([run], store, replace(tools(robot), known_robots=ROBOTS))
    # What is gone from its source cannot be checked any more.
    assert report.refused == {
        f"{run}/recording_0001.mcap": "unsigned",
        f"{run}/recording_0002.mcap": NOT_CHECKED,
    }
    assert listed(store) == ["recording_0000.mcap"]
    # The signed shard is kept; its labels do not come from the frames of the others.
    assert calls(robot) == 3
    (left,) = next(iter(store.runs.values())).shards
    assert left.labels not in before
    assert len(open_dataset([Store(store.folder)]).frames) == 16
    prune(store)
    assert len(list(store.folder.glob("shards/*"))) == 1


def test_shards_of_other_runs_in_the_store_do_not_slip_through(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8])
    prepared(tmp_path, None)
    run.rename(tmp_path / "elsewhere")
    record(run.with_name("other"), walk, [8])
    sign_run(run.with_name("other"), KITCHEN)
    store = Store(tmp_path / "store")
    report = prepare([run.with_name("other")], store, Tools(RECIPE, known_robots=ROBOTS))
    assert report.refused == {f"{run}/recording_0000.mcap": NOT_CHECKED}
    assert [source.source for source in store.runs.values() if source.shards] == [str(run.with_name("other"))]


def test_unchecked_shards_are_refused_before_the_source_is_read(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8])
    prepared(tmp_path, None)
    run.rename(tmp_path / "elsewhere")
    with pytest.raises(TrainerError, match="is no directory"):
        prepared(tmp_path)
    assert listed(Store(tmp_path / "store")) == []


def test_a_robot_that_is_not_known_any_more_loses_its_shards_and_gets_them_back(
    walk: Frames, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(run, walk, [8, 8])
    sign_run(run, KITCHEN)
    prepared(tmp_path)
    found = looked_at(monkeypatch)
    (run / "recording_0001.mcap").unlink()
    store, report = prepared(tmp_path, NO_ROBOT_OF_OURS)
    assert listed(store) == []
    assert report.refused[f"{run}/recording_0001.mcap"] == f"signed by an unknown robot {public(KITCHEN)[:8]}..."
    # Segments need not be there: their signatures were valid.
    assert len(listed(prepared(tmp_path)[0])) == 2
    assert found == []


def test_a_list_that_an_earlier_version_wrote_is_read_and_not_trusted(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8])
    store, _ = prepared(tmp_path, None)
    (file,) = store.folder.glob("runs/*.json")
    plain = json.loads(file.read_text())
    for entry in plain["segments"]:
        for name in ("signed_by", "signed_digest", "previous", "refused", "refused_with"):
            entry.pop(name, None)
    file.write_text(json.dumps(plain))
    assert len(listed(Store(store.folder))) == 1
    assert listed(prepared(tmp_path)[0]) == []


def test_a_signed_segment_that_cannot_be_read_is_damaged_and_not_refused(run: Path, tmp_path: Path) -> None:
    record(run, room(8, (16, 32)), [0])
    sign_run(run, KITCHEN)
    store, report = prepared(tmp_path)
    assert (listed(store), report.refused) == ([], {})
    assert "holds no frame" in report.damaged[str(run / "recording_0000.mcap")]
    assert prepared(tmp_path)[1].segments == 0


def test_segments_that_follow_one_another_are_not_warned_about(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8, 8, 8])
    sign_run(run, KITCHEN)
    # The robot's buffer drops the oldest segments.
    (run / "recording_0000.mcap").unlink()
    assert prepared(tmp_path)[1].breaks == []


def test_a_segment_that_is_missing_is_warned_about_once(walk: Frames, run: Path, tmp_path: Path) -> None:
    record(run, walk, [8, 8, 8])
    sign_run(run, KITCHEN)
    (run / "recording_0001.mcap").unlink()
    store, report = prepared(tmp_path)
    assert report.breaks == [
        f"{run}/recording_0002.mcap does not follow recording_0000.mcap, the signed segment before it: segments are "
        "missing or of another run"
    ]
    assert len(listed(store)) == 2
    assert prepared(tmp_path)[1].breaks == []


def test_a_signed_segment_of_another_run_is_warned_about(walk: Frames, run: Path, tmp_path: Path) -> None:
    for folder, identity in ((run, "aa" * 16), (tmp_path / "other", "bb" * 16)):
        record(folder, walk, [8, 8, 8], identity={"run": identity})
        sign_run(folder, KITCHEN, identity)
    assert prepared(tmp_path)[1].breaks == []
    (tmp_path / "other/recording_0001.mcap").replace(run / "recording_0001.mcap")
    breaks = prepared(tmp_path)[1].breaks
    assert [line.partition(" does not follow ")[0] for line in breaks] == [
        f"{run}/recording_0001.mcap",
        f"{run}/recording_0002.mcap",
    ]


def test_the_command_names_what_it_refuses(
    walk: Frames, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(run, walk, [8, 8, 8])
    sign_run(run, KITCHEN)
    record(run, walk, [8, 8, 8], range(1, 2))
    robots = tmp_path / "robots.txt"
    robots.write_text(f"{public(KITCHEN)} kitchen\n")
    command = ["prepare", str(run), "--out", str(tmp_path / "store"), "--coarse", "none", "--robots", str(robots)]
    assert main(command) == 0
    said = capsys.readouterr()
    assert f"{run}/recording_0001.mcap: refused: unsigned\n" in said.err
    assert f"warning: {run}/recording_0002.mcap does not follow recording_0000.mcap" in said.err
    assert "16 frames; 3 segments were new" in said.out
    assert "signed: 2 of kitchen\nrefused segments in the store, which no known robot signed: 1\n" in said.out
    # A store without a frame is an error, as with damaged segments.
    robots.write_text(f"{public(HALL)}\n")
    assert main(command) == 1
    assert f"no segment is signed by a robot of {robots}" in capsys.readouterr().err
