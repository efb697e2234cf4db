"""Exports as LeRobot datasets, read back with pyarrow. LeRobot itself reads one in `tests/peers`."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pyarrow import parquet

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.exports.lerobot import dataset

from .segments import NAN, STEP_NS, Recorded, closing_tick, cut, full_tick, full_ticks, png, write_run, write_segment

IMAGE = "observation.images.front"


def convert(run: Path, to: Path) -> int:
    return main(["convert", str(run), "--as", "lerobot", "--out", str(to)])


def exported(ticks: Sequence[Recorded], folder: Path) -> Path:
    """Exports ticks, and one that closes them, as a run of one segment."""
    write_segment(folder / "recording_0000.mcap", [*ticks, closing_tick(ticks[-1])])
    assert convert(folder / "recording_0000.mcap", folder / "dataset") == 0
    return folder / "dataset"


def table(file: Path) -> list[dict[str, Any]]:
    # Without the conversion to `datasets` or pandas.
    rows: list[dict[str, Any]] = parquet.read_table(file).to_pylist()
    return rows


def data(to: Path) -> list[dict[str, Any]]:
    return [row for file in sorted(to.glob("data/*/*.parquet")) for row in table(file)]


def episodes(to: Path) -> list[dict[str, Any]]:
    return table(to / "meta/episodes/chunk-000/file-000.parquet")


def meta(to: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((to / "meta" / name).read_text())
    return content


def test_every_image_with_its_state_and_sent_command_is_a_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # More than one row group.
    ticks = [tick.at(5_000_000_000 + tick.time_ns) for tick in full_ticks(230)]
    to = exported(ticks, tmp_path)
    assert "1 episodes, 230 images, 0 left out" in capsys.readouterr().out
    rows = data(to)
    assert len(rows) == len(ticks)
    for at, (row, tick) in enumerate(zip(rows, ticks, strict=True)):
        # t_map_odom rotates by -0.1, and t_odom_base by 0.1.
        x_m, y_m = 0.02 * at, 0.01
        cos, sin = np.cos(-0.1), np.sin(-0.1)
        pose = [0.5 + cos * x_m - sin * y_m, sin * x_m + cos * y_m, 0.0]
        assert row["observation.state"] == pytest.approx([*pose, 0.25, 0.125 * at], abs=1e-6)
        # The command in force when the next tick began.
        assert row["action"] == [np.float32(0.3), np.float32(-0.01 * (at + 1))]
        assert tick.rgb is not None
        assert row[IMAGE] == {"bytes": png(tick.rgb), "path": None}
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(row[IMAGE]["bytes"]))), tick.rgb)
        assert (row["frame_index"], row["index"], row["episode_index"], row["task_index"]) == (at, at, 0, 0)


def late(tick: int) -> int:
    """The time of a tick in a loop that is late by up to 30 ms, differently each time."""
    return 3_600_000_000_000 + tick * STEP_NS + (tick * 7_777_777) % 30_000_000


def test_timestamps_are_equally_spaced_and_time_s_is_the_real_time(tmp_path: Path) -> None:
    to = exported([tick.at(late(at)) for at, tick in enumerate(full_ticks(150))], tmp_path)
    assert meta(to, "info.json")["fps"] == 10
    for at, row in enumerate(data(to)):
        assert row["timestamp"] == np.float32(at / 10)
        assert row["time_s"] == pytest.approx((late(at) - late(0)) * 1e-9, abs=1e-9)
    assert episodes(to)[0]["start_time_s"] == pytest.approx(3600, abs=1e-9)


def test_a_gap_starts_a_new_episode_and_a_single_lost_image_does_not(tmp_path: Path) -> None:
    ticks = full_ticks(60)
    del ticks[10]
    ticks[29:] = [tick.at(tick.time_ns + 3_000_000_000) for tick in ticks[29:]]
    to = exported(ticks, tmp_path)
    spans = [[row[key] for key in ("length", "dataset_from_index", "dataset_to_index")] for row in episodes(to)]
    # The frames before the lost tick and before the gap have no command that answered them.
    assert spans == [[27, 0, 27], [30, 27, 57]]
    rows = data(to)
    assert [(rows[at]["episode_index"], rows[at]["frame_index"]) for at in (26, 27, 56)] == [(0, 26), (1, 0), (1, 29)]
    assert meta(to, "info.json")["splits"] == {"train": "0:2"}


def test_ticks_without_an_image_a_command_or_a_finite_pose_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ticks = full_ticks(20)
    ticks[3] = replace(ticks[3], rgb=None)
    # Without it, the frame before it has no action.
    ticks[8] = replace(ticks[8], decision=None)
    ticks[5] = ticks[5].with_wheel(linear_mps=NAN)
    rows = data(exported(ticks, tmp_path))
    assert "1 episodes, 17 images, 2 left out" in capsys.readouterr().out
    assert all(np.isfinite(row["observation.state"]).all() for row in rows)
    # The tick without a decision has the pose of its wheels.
    [without_decision] = [row for row in rows if row["observation.state"][0] == np.float32(0.24)]
    assert without_decision["observation.state"][2] == np.float32(0.08)


def test_a_cut_run_is_exported_up_to_its_last_complete_tick(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ticks = full_ticks(60)
    _, last = write_run(tmp_path / "run", [ticks[:30], ticks[30:]])
    cut(last, 0.5)
    assert convert(tmp_path / "run", tmp_path / "dataset") == 1
    assert "left out of" in (said := capsys.readouterr().err)
    assert "the end of recording_0001.mcap, which is cut" in said
    [episode] = episodes(tmp_path / "dataset")
    assert 30 < episode["length"] < 60


def test_statistics_cover_all_frames_and_all_pixels(tmp_path: Path) -> None:
    ticks = full_ticks(130)
    to = exported(ticks, tmp_path)
    stats = meta(to, "stats.json")
    actions = np.array([row["action"] for row in data(to)], np.float64)
    pixels = np.stack([tick.rgb for tick in ticks if tick.rgb is not None]).reshape(-1, 3) / 255
    for values, found in ((actions, stats["action"]), (pixels, stats[IMAGE])):
        expected = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        expected |= {f"q{percent:02}": np.quantile(values, percent / 100, axis=0) for percent in (1, 10, 50, 90, 99)}
        for name, value in expected.items():
            assert np.asarray(found[name]).ravel() == pytest.approx(value, abs=1e-9), name
        assert found["count"] == [130]
    # LeRobot's shape for images.
    assert np.shape(stats[IMAGE]["mean"]) == (3, 1, 1)
    assert set(stats) == set(meta(to, "info.json")["features"])


def test_a_data_file_that_is_full_ends_with_its_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset, "MAX_DATA_FILE", 50_000)
    ticks = [tick.at(tick.time_ns + at // 110 * 3_000_000_000) for at, tick in enumerate(full_ticks(330))]
    to = exported(ticks, tmp_path)
    files = [(row["data/chunk_index"], row["data/file_index"], row["length"]) for row in episodes(to)]
    assert files == [(0, 0, 109), (0, 1, 109), (0, 2, 110)]
    assert [row["index"] for row in data(to)] == list(range(328))
    for at, (_, _, length) in enumerate(files):
        rows = table(to / f"data/chunk-000/file-{at:03}.parquet")
        assert len(rows) == length
        assert {row["episode_index"] for row in rows} == {at}


def test_the_run_and_its_task_are_described(tmp_path: Path) -> None:
    to = exported([full_tick(0), full_tick(1)], tmp_path)
    run = meta(to, "run.json")
    assert run["config"] == {"base": {"track_m": 0.4}}
    assert run["camera"]["fx"] == 8.5
    task = "explore a home by the policy active"
    assert table(to / "meta/tasks.parquet") == [{"task_index": 0, "task": task}]
    assert json.loads(parquet.read_schema(to / "meta/tasks.parquet").metadata[b"pandas"])["index_columns"] == ["task"]
    assert episodes(to)[0]["tasks"] == [task]
    described = meta(to, "info.json")
    assert (described["codebase_version"], described["total_frames"], described["fps"]) == ("v3.0", 2, 10)
    assert described["features"][IMAGE]["shape"] == [12, 16, 3]


def test_a_run_without_an_image_is_refused_and_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_segment(tmp_path / "recording_0000.mcap", [replace(full_tick(0), rgb=None)])
    assert convert(tmp_path, tmp_path / "dataset") == 1
    assert "nothing to export" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["recording_0000.mcap"]
