"""A study of one home trains on what the robot had recorded by then, and measures every network on the same views."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.messages import segments
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.studies.adaptation import AdaptationSettings, check_rounds, pull
from embodied_depth_trainer.training import checkpoint as checkpoints

from ..rooms import room
from ..stores import calls, record


def arguments(robot: Path, out: Path, *more: str) -> list[str]:
    small = ["--after", "40", "--steps", "2", "--views", "8", "--init", "none"]
    return ["adapt", "--scene", "a room", "--out", str(out), "--firmware-host", str(robot), *small, *more]


def test_only_segments_that_are_complete_by_then_are_pulled(tmp_path: Path) -> None:
    record(tmp_path / "run", room(40), [16, 16, 8])
    pulled = tmp_path / "pulled"
    assert pull(tmp_path / "run", 20, pulled) == 16
    assert [file.name for file in segments(pulled / "run")] == ["recording_0000.mcap"]
    assert pull(tmp_path / "run", 32, pulled) == 32
    assert pull(tmp_path / "run", 1000, pulled) == 40
    assert len(segments(pulled / "run")) == 3


def test_a_study_measures_each_network_beside_what_needs_none_and_continues(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(arguments(robot, out)) == 0
    assert "after a rotation on the spot (constant" in capsys.readouterr().out
    (point,) = json.loads((out / "result.json").read_text())["curve"]
    assert (point["frames"], point["steps"]) == (40, 2)
    assert set(point["metrics"]["all"]) >= {"constant", "coarse", "dense", "network"}
    assert checkpoints.load(out / "watch/training/checkpoint.pt").step == 2
    assert (out / "curve.png").read_bytes().startswith(b"\x89PNG")
    before = calls(robot)
    assert main(arguments(robot, out)) == 0
    assert calls(robot) == before


def test_rounds_without_a_new_segment_are_refused_instead_of_waited_for(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", room(40), [16, 16, 8])
    check_rounds(tmp_path / "run", [16, 40])
    with pytest.raises(TrainerError, match="after 20 30 frames, segments with 16 16 frames are complete"):
        check_rounds(tmp_path / "run", [20, 30])
    with pytest.raises(TrainerError, match="further apart"):
        check_rounds(tmp_path / "run", [10])
    assert main(arguments(robot, tmp_path / "out", "--init", "checkpoint.pt")) == 1
    assert "give an ONNX file of `embodied-depth export`" in capsys.readouterr().err


def test_other_settings_and_frames_that_do_not_grow_are_refused(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(arguments(robot, out)) == 0
    assert main(arguments(robot, out, "--seed", "2")) == 1
    assert "seed was 1, now 2" in capsys.readouterr().err
    assert main(arguments(robot, out, "--after", "3000", "1500")) == 1
    assert "--after 3000 1500 are no growing numbers" in capsys.readouterr().err
    assert AdaptationSettings("a room").after[-1] == 12000
