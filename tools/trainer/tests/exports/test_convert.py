"""What cannot be read is named and never left out in silence, and an export replaces nothing but itself."""

from __future__ import annotations

import fcntl
import os
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from pyarrow import parquet

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.exports.folder import RECORD

from .segments import Recorded, cut, full_ticks, write_run, write_segment

LAYOUTS = ("lerobot", "ros2")
Capture = pytest.CaptureFixture[str]


def convert(run: Path, to: Path, layout: str = "lerobot") -> int:
    return main(["convert", str(run), "--as", layout, "--out", str(to)])


def frames(dataset: Path) -> int:
    return sum(parquet.read_metadata(file).num_rows for file in dataset.glob("data/*/*.parquet"))


def names(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def monday(folder: Path, counts: Sequence[int] = (30, 30, 20)) -> list[Path]:
    """The segments of a run."""
    rest = full_ticks(sum(counts))
    parts: list[list[Recorded]] = []
    for count in counts:
        parts.append(rest[:count])
        rest = rest[count:]
    return write_run(folder / "monday", parts)


def test_a_run_that_has_grown_is_exported_again_and_no_other(tmp_path: Path, capsys: Capture) -> None:
    segments = monday(tmp_path)
    last = shutil.move(segments[2], tmp_path / "last")
    to = tmp_path / "dataset"
    assert convert(tmp_path / "monday", to) == 0
    assert frames(to) == 59
    written = (to / "meta/info.json").stat().st_ino
    capsys.readouterr()
    assert convert(tmp_path / "monday", to) == 0
    assert "exported before, and the run has not changed" in capsys.readouterr().out
    assert (to / "meta/info.json").stat().st_ino == written
    shutil.move(last, segments[2])
    assert convert(tmp_path / "monday", to) == 0
    assert frames(to) == 79
    assert names(tmp_path) == ["dataset", "monday"]


def test_an_export_again_of_a_cut_run_says_again_what_was_left_out(tmp_path: Path, capsys: Capture) -> None:
    segments = monday(tmp_path)
    cut(segments[2], 0.7)
    said = []
    for _ in range(2):
        assert convert(tmp_path / "monday", tmp_path / "dataset") == 1
        said.append(capsys.readouterr().err)
    assert said[0] == said[1]
    assert "recording_0002.mcap" in said[0]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_nothing_of_the_user_is_replaced(layout: str, tmp_path: Path, capsys: Capture) -> None:
    monday(tmp_path)
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "photo").write_text("precious")
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    for to in (folder, tmp_path / "empty", tmp_path / "link"):
        assert convert(tmp_path / "monday", to, layout) == 1
        assert f"{to} is there already and is not overwritten" in capsys.readouterr().err
    assert (folder / "photo").read_text() == "precious"


def test_the_export_of_another_run_or_in_another_format_is_not_replaced(tmp_path: Path, capsys: Capture) -> None:
    monday(tmp_path)
    write_segment(tmp_path / "tuesday/recording_0000.mcap", full_ticks(40), policy="random")
    assert convert(tmp_path / "monday", tmp_path / "out") == 0
    for run, layout in (("monday", "ros2"), ("tuesday", "lerobot")):
        assert convert(tmp_path / run, tmp_path / "out", layout) == 1
        assert "of another run or in another format" in capsys.readouterr().err
    assert frames(tmp_path / "out") == 79


def test_a_temporary_folder_of_another_process_is_left_alone(tmp_path: Path) -> None:
    monday(tmp_path)
    taken = tmp_path / f"dataset.{os.getpid()}-0.partial"
    taken.mkdir()
    (taken / "photo").write_text("precious")
    assert convert(tmp_path / "monday", tmp_path / "dataset") == 0
    assert (taken / "photo").read_text() == "precious"
    assert names(tmp_path) == ["dataset", taken.name, "monday"]


def test_of_two_exports_into_one_folder_one_is_complete_and_the_other_fails(tmp_path: Path) -> None:
    monday(tmp_path)
    with ThreadPoolExecutor(2) as pool:
        codes = list(pool.map(lambda _: convert(tmp_path / "monday", tmp_path / "dataset"), range(2)))
    # The second one may have begun when the first had ended, and then has nothing to do.
    assert 0 in codes
    assert frames(tmp_path / "dataset") == 79
    assert names(tmp_path) == ["dataset", "monday"]


def test_each_run_of_a_directory_becomes_an_export_of_its_name(tmp_path: Path, capsys: Capture) -> None:
    monday(tmp_path / "kitchen")
    write_run(tmp_path / "kitchen/tuesday", [full_ticks(10)])
    # What pull-buffer has written beside the runs.
    (tmp_path / "kitchen/tum/monday").mkdir(parents=True)
    (tmp_path / "kitchen/pulled.json").write_text("{}")
    assert convert(tmp_path / "kitchen", tmp_path / "out") == 0
    assert {run: frames(tmp_path / "out" / run) for run in names(tmp_path / "out")} == {"monday": 79, "tuesday": 9}
    write_segment(tmp_path / "kitchen/wednesday/recording_0000.mcap", full_ticks(5))
    (tmp_path / "kitchen/tuesday/recording_0000.mcap").write_bytes(b"no recording at all")
    capsys.readouterr()
    # The others are exported nevertheless.
    assert convert(tmp_path / "kitchen", tmp_path / "out") == 1
    said = capsys.readouterr()
    assert "recording_0000.mcap is damaged" in said.err
    assert "monday: exported before" in said.out
    assert frames(tmp_path / "out/wednesday") == 4
    assert frames(tmp_path / "out/tuesday") == 9


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_segment_that_is_a_link_is_named_and_the_others_are_exported(
    layout: str, tmp_path: Path, capsys: Capture
) -> None:
    segments = monday(tmp_path)
    shutil.move(segments[1], tmp_path / "moved.mcap")
    segments[1].symlink_to(tmp_path / "moved.mcap")
    assert convert(tmp_path / "monday", tmp_path / "out", layout) == 1
    said = capsys.readouterr()
    assert f"cannot read {segments[1]}: it is a symbolic link, which is not followed" in said.err
    assert "missing" not in said.out, "it is there, although it cannot be read"
    assert (tmp_path / "out" / RECORD).exists()
    assert convert(segments[1], tmp_path / "alone", layout) == 1


def test_segments_that_the_robot_deleted_for_space_are_named_and_that_is_no_failure(
    tmp_path: Path, capsys: Capture
) -> None:
    segments = monday(tmp_path, (10, 10, 10, 10, 10))
    for deleted in (segments[0], segments[2], segments[3]):
        deleted.unlink()
    assert convert(tmp_path / "monday", tmp_path / "dataset") == 0
    assert "missing: recording_0002.mcap to recording_0003.mcap; deleted" in capsys.readouterr().out


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_segment_with_a_damaged_chunk_is_refused(layout: str, tmp_path: Path, capsys: Capture) -> None:
    segments = monday(tmp_path)
    data = bytearray(segments[1].read_bytes())
    data[len(data) // 2] ^= 1
    segments[1].write_bytes(data)
    assert convert(tmp_path / "monday", tmp_path / "out", layout) == 1
    said = capsys.readouterr().err
    assert str(segments[1]) in said
    assert "firmware-host buffer recover" in said
    assert names(tmp_path) == ["monday"]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("length", [0, 300])
def test_a_run_without_a_tick_is_refused(layout: str, length: int, tmp_path: Path, capsys: Capture) -> None:
    [segment] = monday(tmp_path, (30,))
    segment.write_bytes(segment.read_bytes()[:length])
    assert convert(tmp_path / "monday", tmp_path / "out", layout) == 1
    assert "nothing to export" in capsys.readouterr().err
    assert names(tmp_path) == ["monday"]


def test_segments_that_were_renamed_out_of_order_are_refused(tmp_path: Path, capsys: Capture) -> None:
    segments = monday(tmp_path)
    between = tmp_path / "between"
    for source, target in ((segments[0], between), (segments[1], segments[0]), (between, segments[1])):
        source.rename(target)
    assert convert(tmp_path / "monday", tmp_path / "dataset") == 1
    said = capsys.readouterr().err
    assert f"{segments[1]}: begins at tick 0" in said
    assert f"{segments[0]} before it at tick 30" in said


def test_a_tick_without_a_message_that_it_promises_is_refused(tmp_path: Path, capsys: Capture) -> None:
    ticks = full_ticks(3)
    ticks[1].tick["snapshot"] = True
    write_segment(tmp_path / "run/recording_0000.mcap", ticks)
    assert convert(tmp_path / "run", tmp_path / "out") == 1
    assert "tick 1 has no message on /robot/snapshot" in capsys.readouterr().err


def test_a_segment_that_is_being_written_is_named_as_such(tmp_path: Path, capsys: Capture) -> None:
    segments = monday(tmp_path)
    cut(segments[2], 0.7)
    with segments[2].open("rb") as recorder:
        fcntl.flock(recorder, fcntl.LOCK_EX)
        assert convert(tmp_path / "monday", tmp_path / "dataset") == 1
    assert "the rest of recording_0002.mcap, which is still being written" in capsys.readouterr().err


@pytest.mark.parametrize(("layout", "package"), [("lerobot", "pyarrow"), ("ros2", "rosbags")])
def test_a_missing_package_is_named_with_the_command_that_installs_it(
    layout: str, package: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monday(tmp_path)
    for module in [name for name in sys.modules if f"exports.{layout}" in name or name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, package, None)
    assert convert(tmp_path / "monday", tmp_path / "out", layout) == 1
    said = capsys.readouterr().err
    assert f"--as {layout} needs the package {package}" in said
    assert "tools/trainer[exports]" in said


def test_a_path_without_segments_is_refused(tmp_path: Path, capsys: Capture) -> None:
    assert convert(tmp_path, tmp_path / "out") == 1
    assert "contains no recording_NNNN.mcap" in capsys.readouterr().err
    assert convert(tmp_path / "nothing", tmp_path / "out") == 1
    assert "does not exist" in capsys.readouterr().err
