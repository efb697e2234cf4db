"""Processes that fill one store in parts, at once and in any order, make the store that one process makes."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import store as stored
from embodied_depth_trainer.store.parts import Part
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.sources import LocalSegment, RecordedRun
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..signing import KITCHEN, public, sign
from ..stores import calls, record

SOURCES = Path(__file__).resolve().parents[2] / "src"
SEGMENTS = 5


@pytest.fixture
def pulled(tmp_path: Path) -> Path:
    """Two runs, of three segments and of two. Their first segments are equal."""
    record(tmp_path / "pulled/monday", room(40), [14, 14, 12])
    record(tmp_path / "pulled/tuesday", room(40), [14, 26])
    return tmp_path / "pulled"


def words(pulled: Path, out: Path, robot: Path, *options: str) -> list[str]:
    return ["prepare", str(pulled), "--out", str(out), "--firmware-host", str(robot), *options]


def started(pulled: Path, out: Path, robot: Path, *options: str) -> subprocess.Popen[bytes]:
    """`prepare` in a process of its own."""
    command = [sys.executable, "-m", "embodied_depth_trainer", *words(pulled, out, robot, *options)]
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(SOURCES)})


def content(out: Path) -> dict[str, bytes]:
    """All files of a store."""
    return {str(file.relative_to(out)): file.read_bytes() for file in out.rglob("*") if file.is_file()}


@pytest.fixture
def alone(pulled: Path, tmp_path: Path, robot: Path) -> dict[str, bytes]:
    """The store that one process makes, with one shard for the two equal segments."""
    assert main(words(pulled, tmp_path / "alone", robot)) == 0
    assert calls(robot) == SEGMENTS - 1
    robot.with_name("firmware-host.calls").unlink()
    return content(tmp_path / "alone")


def run_of(source: str, numbers: Sequence[int]) -> RecordedRun:
    return RecordedRun(source, tuple(LocalSegment(source, f"recording_{number:04d}.mcap") for number in numbers))


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_every_segment_is_in_one_part_and_a_run_is_divided_evenly(count: int) -> None:
    run = run_of("/pulled/monday", range(20))
    parts = [Part(number, count).of(run) for number in range(1, count + 1)]
    assert sorted(map(str, itertools.chain(*parts))) == sorted(map(str, run.segments))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_a_segment_stays_in_its_part_when_its_run_grows_and_old_segments_are_removed() -> None:
    # Segment 10000 has a longer name than segment 9999.
    before, after = run_of("/pulled/monday", range(9990, 10000)), run_of("/pulled/monday", range(9995, 10005))
    both = set(before.segments) & set(after.segments)
    for number in (1, 2, 3):
        assert both & set(Part(number, 3).of(before)) == both & set(Part(number, 3).of(after))


def test_runs_of_one_segment_are_not_all_in_the_first_part() -> None:
    runs = [run_of(f"/pulled/{name}", [0]) for name in range(40)]
    sizes = [sum(len(Part(number, 4).of(run)) for run in runs) for number in (1, 2, 3, 4)]
    assert min(sizes) > 0


@pytest.mark.parametrize("order", [(1, 2, 3), (3, 1, 2)])
def test_parts_in_any_order_and_then_prepare_make_the_store_of_one_process(
    pulled: Path, tmp_path: Path, robot: Path, alone: dict[str, bytes], order: Sequence[int]
) -> None:
    out = tmp_path / "store"
    for number in order:
        assert main(words(pulled, out, robot, "--part", f"{number}/3")) == 0
    assert calls(robot) == SEGMENTS - 1
    assert not (out / "runs").exists()
    assert not (out / "labels").exists()
    assert main(words(pulled, out, robot)) == 0
    # Shards are found by the digests of their segments, which are read for it.
    assert calls(robot) == SEGMENTS - 1
    assert content(out) == alone


def test_parts_at_the_same_time_and_then_prepare_make_the_store_of_one_process(
    pulled: Path, tmp_path: Path, robot: Path, alone: dict[str, bytes]
) -> None:
    out = tmp_path / "store"
    parts = [started(pulled, out, robot, "--part", f"{number}/2") for number in (1, 2)]
    assert [part.wait() for part in parts] == [0, 0]
    made = calls(robot)
    # Two parts may both make the shard of two equal segments.
    assert made in (SEGMENTS - 1, SEGMENTS)
    assert main(words(pulled, out, robot)) == 0
    assert calls(robot) == made
    assert content(out) == alone


def test_a_part_that_is_killed_goes_on_where_it_was(
    pulled: Path, tmp_path: Path, robot: Path, alone: dict[str, bytes]
) -> None:
    out = tmp_path / "store"
    killer = kills_at_the_second_segment(robot)
    assert started(pulled, out, killer, "--part", "1/1").wait() == -signal.SIGKILL
    assert calls(robot) == 1
    assert main(words(pulled, out, killer, "--part", "1/1")) == 0
    assert calls(robot) == SEGMENTS - 1
    # What was half written has another name than any shard, and is removed by --prune only.
    assert main(words(pulled, out, killer, "--prune")) == 0
    assert calls(robot) == SEGMENTS - 1
    assert content(out) == alone


def kills_at_the_second_segment(robot: Path) -> Path:
    """A program that kills the process that calls it for the second time, once, and otherwise does what the robot
    does."""
    folder = robot.parent / "killer"
    folder.mkdir()
    program = folder / "firmware-host"
    program.write_text(
        f"""#!/bin/sh
if [ "$1" = perceive ] && [ -e {robot}.calls ] && mkdir {folder}/killed 2>/dev/null; then kill -9 $PPID; exit 1; fi
exec {robot} "$@"
"""
    )
    program.chmod(0o755)
    return program


def test_what_no_part_has_made_prepare_makes(
    pulled: Path, tmp_path: Path, robot: Path, alone: dict[str, bytes]
) -> None:
    assert main(words(pulled, tmp_path / "store", robot, "--part", "2/3")) == 0
    assert calls(robot) < SEGMENTS - 1
    assert main(words(pulled, tmp_path / "store", robot)) == 0
    assert content(tmp_path / "store") == alone


def test_a_part_makes_only_what_a_store_lacks(pulled: Path, tmp_path: Path, robot: Path) -> None:
    store = tmp_path / "store"
    assert main(words(pulled / "monday", store, robot)) == 0
    before = content(store)
    assert main(words(pulled, store, robot, "--part", "1/1")) == 0
    assert calls(robot) == SEGMENTS - 1
    after = content(store)
    assert {name: after[name] for name in before} == before


def test_a_part_without_segments_is_done(
    pulled: Path, tmp_path: Path, robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(1, 10):
        assert main(words(pulled / "tuesday", tmp_path / "store", robot, "--part", f"{number}/9")) == 0
    said = capsys.readouterr().out
    assert said.count("0 segments were read") == 7
    assert "without --part lists their shards" in said


def test_a_part_makes_no_shard_of_what_no_known_robot_signed(pulled: Path, tmp_path: Path, robot: Path) -> None:
    sign(pulled / "monday/recording_0000.mcap", KITCHEN)
    robots = tmp_path / "robots.txt"
    robots.write_text(public(KITCHEN))
    for number in (1, 2):
        options = ("--part", f"{number}/2", "--robots", str(robots))
        assert main(words(pulled, tmp_path / "store", robot, *options)) == 0
    assert len(list(tmp_path.glob("store/shards/*"))) == 1
    assert not (tmp_path / "store/runs").exists()
    assert main(words(pulled, tmp_path / "store", robot, "--robots", str(robots))) == 0
    assert calls(robot) == 1
    assert Store(tmp_path / "store").frames == 14


@pytest.mark.parametrize("text", ["0/4", "5/4", "1/0", "-1/4", "2", "a/b", "1/2/3", "2/4.0", ""])
def test_a_part_that_does_not_exist_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["prepare", "pulled", "--out", "store", f"--part={text}"])
    said = capsys.readouterr().err
    assert "argument --part: " in said
    assert f"`{text}`" in said
    assert "such as 2/8" in said or "counted from 1" in said


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--prune"], "give them to the `prepare` without --part"),
        (["--check"], "give them to the `prepare` without --part"),
        (["--on", "ray"], "divides the segments itself"),
    ],
)
def test_what_is_not_of_a_part_is_refused(
    options: list[str], why: str, tmp_path: Path, robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words(tmp_path, tmp_path / "store", robot, "--part", "1/2", *options)) == 1
    assert why in capsys.readouterr().err
    assert not (tmp_path / "store").exists()


def test_processes_that_begin_a_store_at_the_same_moment_do_not_meet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun_meanwhile(Recipe("none", labels=False), tmp_path, monkeypatch)
    assert Store.create(tmp_path / "store", Recipe("none", labels=False)).frames == 0
    assert [file.name for file in (tmp_path / "store").iterdir()] == ["recipe.json"]


def test_of_processes_that_begin_a_store_with_different_recipes_the_first_one_wins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Recipe("none", size=(16, 32), labels=False)
    begun_meanwhile(first, tmp_path, monkeypatch)
    with pytest.raises(TrainerError, match="give another --out"):
        Store.create(tmp_path / "store", Recipe("none", labels=False))
    assert Store.create(tmp_path / "store", first).recipe["size"] == [16, 32]
    assert [file.name for file in (tmp_path / "store").iterdir()] == ["recipe.json"]


def begun_meanwhile(recipe: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets another process begin the store when this one has half written its recipe."""
    sync = os.fsync
    names = iter(["this", "another"])
    left = [recipe]

    def synced(file: int) -> None:
        if left:
            Store.create(tmp_path / "store", left.pop())
        sync(file)

    monkeypatch.setattr(stored, "process_name", lambda: next(names))
    monkeypatch.setattr(os, "fsync", synced)
