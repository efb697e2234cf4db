"""The closed loop follows the paper's schedule, learns, and reaches the same result however often it is interrupted."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.studies.jobs import read_jobs
from embodied_depth_trainer.studies.robot import robot_config
from embodied_depth_trainer.studies.schedule import Schedule
from embodied_depth_trainer.training import checkpoint as checkpoints

TRAINER = Path(__file__).resolve().parents[2]


def arguments(robot: Path, out: Path, *more: str) -> list[str]:
    small = ["--scale", "0.0034", "--size", "32x64", "--batch", "12", "--views", "8", "--learning-rate", "3e-3"]
    return ["loop", "--scene", "a room", "--out", str(out), "--firmware-host", str(robot), *small, *more]


def start(robot: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "embodied_depth_trainer", *arguments(robot, out)]
    environment = {**os.environ, "PYTHONPATH": str(TRAINER / "src")}
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def result(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "result.json").read_text())
    return found


def test_the_full_schedule_equals_that_of_the_paper() -> None:
    schedule = Schedule.scaled(1.0)
    rounds = list(schedule.rounds())
    assert [r.frames for r in rounds] == [6000, 9000, 12000, 15000, 18000, 21000, 24000, 27000, 30000]
    # One pass after the warm-up, two before each of eight times 3,000 frames, four at the end (the paper's released
    # code).
    assert [r.passes for r in rounds] == [3, 2, 2, 2, 2, 2, 2, 2, 4]
    assert schedule.steps(8, batch=12) == 390_000 // 12


def test_a_scaled_schedule_keeps_its_shape_and_one_that_is_too_short_is_refused() -> None:
    assert [r.frames for r in Schedule.scaled(0.1).rounds()] == list(range(600, 3001, 300))
    with pytest.raises(TrainerError, match=r"every 3 frames; give --scale"):
        Schedule.scaled(0.001)


def test_the_alternation_between_frontiers_and_inconsistencies_scales_with_the_schedule() -> None:
    def exploration(scale: float) -> str:
        schedule = Schedule.scaled(scale)
        return robot_config((96, 320), 1.0, schedule.warm_up, schedule.frames).split("[exploration]\n")[1]

    assert exploration(1.0) == "warm_up_frames = 6000\nfrontier_frames = 800\ninconsistency_frames = 400\n"
    assert exploration(0.25) == "warm_up_frames = 1500\nfrontier_frames = 200\ninconsistency_frames = 100\n"
    assert exploration(0.01) == "warm_up_frames = 60\nfrontier_frames = 80\ninconsistency_frames = 40\n"


def test_the_loop_learns_and_reports_the_baselines(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(arguments(robot, out)) == 0
    curve = result(out)["curve"]
    assert [point["frames"] for point in curve] == [0, *range(20, 101, 10)]
    last = curve[-1]["metrics"]
    assert set(last) == {"all", "drive", "turn"}
    # Views after a rotation have no coarse depth, so an untrained student knows nothing there.
    untrained, trained = (point["metrics"]["turn"]["student"] for point in (curve[0], curve[-1]))
    assert trained["delta1"] > untrained["delta1"]
    assert "coarse" in last["drive"]
    assert "coarse" not in last["turn"]
    assert 0 < last["all"]["constant"]["delta1"] < 1
    for image in ("curve.png", "views.png"):
        assert (out / image).read_bytes().startswith(b"\x89PNG")
    # `evaluate` gives the same numbers.
    numbers = tmp_path / "numbers.json"
    checkpoint = out / "training/checkpoint.pt"
    command = ["evaluate", "--views", str(out / "views"), "--checkpoint", str(checkpoint), "--json", str(numbers)]
    assert main(command) == 0
    assert "turn:" in capsys.readouterr().out
    found = json.loads(numbers.read_text())
    for part in ("all", "drive", "turn"):
        row = next(values for name, values in found[part].items() if re.fullmatch(r"student, \d+ steps", name))
        assert row["delta1"] == pytest.approx(last[part]["student"]["delta1"])


def test_a_loop_can_learn_from_labels_alone(robot: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(arguments(robot, out, "--labels", "--decay")) == 0
    assert result(out)["settings"]["labels"]
    saved = checkpoints.load(out / "training/checkpoint.pt")
    weights = [saved.settings[f"{what}_weight"] for what in ("photometric", "coarse", "label")]
    assert weights == [0, 0, 1]
    # The learning rate falls to zero in the last training.
    schedule = Schedule.scaled(0.0034)
    assert saved.settings["decay"] == [schedule.steps(7, 12), schedule.steps(8, 12)]
    assert saved.step == schedule.steps(8, 12)
    first, last = (point["metrics"]["turn"]["student"] for point in (result(out)["curve"][0], result(out)["curve"][-1]))
    assert last["delta1_unscaled"] > first["delta1_unscaled"]


def test_labels_are_refused_for_networks_whose_loss_does_not_use_them(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for network in ("sc_depth_r18", "manydepth_r18"):
        out = tmp_path / network
        assert main(arguments(robot, out, "--labels", "--network", network)) == 1
        assert "omit --labels" in capsys.readouterr().err
        assert not out.exists()


def killed_when(robot: Path, out: Path, is_time: Callable[[], bool]) -> None:
    loop = start(robot, out)
    while not is_time() and loop.poll() is None:
        time.sleep(0.01)
    if loop.poll() is not None:
        pytest.fail(f"the loop ended before it could be killed: {loop.communicate()[1].decode()}")
    loop.send_signal(signal.SIGKILL)
    loop.wait()


def test_a_loop_that_is_killed_repeatedly_reaches_the_same_result(robot: Path, tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    cut = tmp_path / "cut"
    assert main(arguments(robot, whole)) == 0
    moments: list[Callable[[], bool]] = [
        (cut / "views.partial").exists,
        (cut / "hand-over/round_0000.json").exists,
        (cut / "hand-over/model_0001.onnx").exists,
        (cut / "rounds/round_0003.json").exists,
        (cut / "run/summary.json").exists,
        (cut / "rounds/round_0008.json").exists,
    ]
    for is_time in moments:
        killed_when(robot, cut, is_time)
        assert not (cut / "result.json").exists()
    assert start(robot, cut).wait() == 0
    assert (cut / "result.json").read_bytes() == (whole / "result.json").read_bytes()


def test_a_robot_that_does_not_repeat_its_run_is_detected(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    killed_when(robot, out, (out / "hand-over/round_0001.json").exists)
    request = out / "hand-over/round_0001.json"
    request.write_text(request.read_text().replace('"digest": "', '"digest": "other '))
    assert main(arguments(robot, out)) == 1
    assert "does not repeat the interrupted run" in capsys.readouterr().err


def test_errors_name_the_impossible_request_and_what_to_do(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(arguments(robot, out, "--scene", "nowhere")) == 1
    assert "scene `nowhere` does not exist" in capsys.readouterr().err
    assert main(arguments(robot, out, "--scene", "a room", "--seed", "9")) == 1
    message = capsys.readouterr().err
    assert "seed was 1, now 9" in message
    assert "--out" in message
    assert main(arguments(tmp_path / "none", tmp_path / "other")) == 1
    assert "cargo build --release -p firmware-host" in capsys.readouterr().err


def test_a_failed_job_does_not_stop_the_other_jobs(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(TRAINER / "src"))
    lines = [
        shlex.join(arguments(robot, tmp_path / "a", "--init", "shipped", "--amp")[1:]),
        "# nothing",
        shlex.join(arguments(robot, tmp_path / "b", "--scene", "nowhere")[1:]),
        shlex.join(arguments(robot, tmp_path / "c", "--network", "monodepth2_r18")[1:]),
    ]
    jobs = tmp_path / "jobs.txt"
    jobs.write_text("\n".join(lines))
    assert len(read_jobs(jobs)) == 3
    # The command of a SLURM array.
    assert main(["loop", "--jobs", str(jobs), "--job", "1"]) == 0
    before = (tmp_path / "a/result.json").stat().st_mtime_ns
    assert main(["loop", "--jobs", str(jobs), "--workers", "2"]) == 1
    assert "1 of 3 jobs failed (2)" in capsys.readouterr().err
    assert result(tmp_path / "c")["settings"]["network"] == "monodepth2_r18"
    shipped = result(tmp_path / "a")["settings"]
    assert shipped["init"].startswith("default.onnx sha256:")
    assert shipped["amp"]
    assert "init" not in result(tmp_path / "c")["settings"]
    assert (tmp_path / "a/result.json").stat().st_mtime_ns == before
    assert main(["loop", "--jobs", str(jobs), "--job", "4"]) == 1
    assert "there is no job 4" in capsys.readouterr().err
