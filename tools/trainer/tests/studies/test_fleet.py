"""`embodied-depth fleet`: one network per policy from many homes, with a fake robot."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torchvision.models import resnet18

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.studies.study import collect

FRAMES = 30
STEPS = 2
HOME = ("--scene", "builtin:apartment?seed=1")


def arguments(robot: Path, out: Path, *more: str) -> list[str]:
    sizes = ["--frames", f"{FRAMES}", "--steps", f"{STEPS}", "--views", "4", "--size", "32x64", "--batch", "4"]
    return ["fleet", *sizes, "--policy", "random", "--firmware-host", str(robot), "--out", str(out), *more]


def test_every_network_learns_from_all_homes_and_is_evaluated_in_each(robot: Path, tmp_path: Path) -> None:
    weights = tmp_path / "weights.pth"
    torch.save(resnet18(weights=None).state_dict(), weights)
    more = [*HOME, "--scene", "homes/kitchen.glb", "--network", "student", "--network", "monodepth2_r18"]
    assert main(arguments(robot, tmp_path, *more, "--encoder", str(weights))) == 0
    study = collect(tmp_path / "results")
    found = {(run.scene, run.policy, run.network) for run in study.runs}
    homes = ("builtin:apartment?seed=1", "kitchen.glb")
    networks = ("student", "monodepth2_r18")
    assert found == {(home, "random", network) for home in homes for network in networks}
    assert study.settings["schedule"] == {"frames": FRAMES, "steps": STEPS, "homes": 2}
    assert study.settings["encoder"] == "weights.pth"
    for run in study.runs:
        first, last = run.curve
        assert (first.frames, last.frames, last.steps) == (0, 2 * FRAMES, STEPS)
        assert first.metrics != last.metrics
        assert 0 < run.value(of="constant") < 1
    # Both networks use the same recordings.
    assert len(list((tmp_path / "recordings").iterdir())) == 2


def test_an_interrupted_study_continues_without_exploring_again_and_refuses_other_settings(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = arguments(robot, tmp_path, *HOME, "--network", "student", "--init", "shipped")
    assert main(command) == 0
    (file,) = (tmp_path / "results").rglob("result.json")
    (recording,) = (tmp_path / "recordings").iterdir()
    before = file.read_text()
    made = recording.stat().st_mtime_ns
    file.unlink()
    assert main(command) == 0
    assert (file.read_text(), recording.stat().st_mtime_ns) == (before, made)
    assert main([*command, "--network", "edn_r18"]) == 1
    assert "--init shipped fits one architecture" in capsys.readouterr().err
    # Other settings are refused: half of the study would have the old ones.
    assert main([*command, "--frames", "40"]) == 1
    assert "frames was 30, now 40; give the same settings or another --out" in capsys.readouterr().err


def test_a_failed_exploration_names_the_home_and_zero_steps_are_refused(
    robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = arguments(robot, tmp_path, "--scene", "nowhere", "--network", "student")
    assert main(command) == 1
    assert "did not explore nowhere" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()
    assert main([*command, "--steps", "0"]) == 1
    assert "0 steps" in capsys.readouterr().err
