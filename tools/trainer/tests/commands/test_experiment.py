"""Experiment files, the frame buffer, and TensorBoard."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from embodied_depth_trainer.commands import experiment
from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.buffer import pose_bins, select
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.pairs import PairRule, Pairs, pairs_by_baseline
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.training import checkpoint as checkpoints

from ..rooms import room
from ..stores import record, without_coarse


@pytest.fixture
def store(tmp_path: Path) -> Path:
    record(tmp_path / "run", room(24), [24])
    return without_coarse(tmp_path / "run", tmp_path / "store").folder


def test_typed_options_override_the_experiment_file(store: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    out = tmp_path / "out"
    file.write_text(
        f'store = ["{store}"]\nnetwork = "monodepth2_r18"\nsteps = 1\nbatch = 4\nsmoothness = 0.5\n'
        "baseline = [0.04, 0.2]\nauto_mask = true\nno_exposure = false\n"
    )
    assert main(["train", "--experiment", str(file), "--batch", "2", "--out", str(out)]) == 0
    settings = checkpoints.load(out / "checkpoint.pt").settings
    assert (settings["network"], settings["batch"]) == ("monodepth2_r18", 2)
    assert (settings["loss"]["smoothness"], settings["loss"]["auto_mask"], settings["loss"]["exposure"]) == (
        0.5,
        True,
        True,
    )


def test_the_written_experiment_file_starts_the_same_training(store: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    again = tmp_path / "again"
    options = ["--network", "sc_depth_r18", "--batch", "2", "--no-auto-mask", "--geometry", "0.2"]
    assert main(["train", "--store", str(store), *options, "--steps", "1", "--out", str(out)]) == 0
    assert main(["train", "--experiment", str(out / "experiment.toml"), "--out", str(again)]) == 0
    one, two = (checkpoints.load(folder / "checkpoint.pt") for folder in (out, again))
    assert one.settings == two.settings
    assert tomllib.loads((out / "experiment.toml").read_text())["geometry"] == 0.2


def test_an_invalid_experiment_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.toml"
    assert main(["train", "--experiment", str(file)]) == 1
    file.write_text("steps = ")
    assert main(["train", "--experiment", str(file)]) == 1
    assert "is not valid TOML" in capsys.readouterr().err
    file.write_text("[loss]\nsmoothness = 1\n")
    with pytest.raises(TrainerError, match="cannot be an option"):
        experiment.read(file)


def visits(counts: list[int]) -> tuple[Frames, Pairs]:
    """This many frames at each of several places 3 m apart, one place after the other."""
    frames = room(sum(counts))
    frames.t_world_camera[:] = np.eye(4)
    frames.t_world_camera[:, 0, 3] = 3.0 * np.repeat(np.arange(len(counts)), counts) + 0.1
    every = np.arange(len(frames))
    return frames, Pairs(every, [every[:1]] * len(frames), [every[-1:]] * len(frames))


def test_a_buffer_by_pose_keeps_places_that_the_newest_frames_lack() -> None:
    frames, pairs = visits([20, 4, 60])
    newest = select(frames, pairs, 30, "newest", 0)
    assert newest.targets.tolist() == list(range(54, 84))
    spread = select(frames, pairs, 30, "poses", 0)
    bins = pose_bins(frames)[spread.targets]
    assert np.unique(bins, return_counts=True)[1].tolist() == [13, 4, 13]
    assert len(spread) == len(spread.earlier) == 30
    assert select(frames, pairs, 30, "poses", 0).targets.tolist() == spread.targets.tolist()
    assert select(frames, pairs, 100, "poses", 0) is pairs
    with pytest.raises(TrainerError, match="is empty"):
        select(frames, pairs, 0, "poses", 0)


def test_rotating_on_the_spot_visits_several_pose_bins() -> None:
    frames = room(36)
    for index, pose in enumerate(frames.t_world_camera):
        angle = np.radians(10 * index)
        pose[:] = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    assert 8 <= len(np.unique(pose_bins(frames))) <= 16


def test_tensorboard_gets_the_loss_and_an_image(tmp_path: Path, store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from embodied_depth_trainer.training import tensorboard as board

    monkeypatch.setattr(board, "SCALARS_EVERY", 1)
    monkeypatch.setattr(board, "IMAGES_EVERY", 2)
    options = ["--network", "monodepth2_r18", "--batch", "2", "--steps", "2", "--tensorboard"]
    assert main(["train", "--store", str(store), *options, "--out", str(tmp_path / "out")]) == 0
    events = EventAccumulator(str(tmp_path / "out/tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("loss")] == [1, 2]
    image = events.Images("image and disparity")[0]
    assert (image.height, image.width) == (64, 96)


def test_pairs_of_a_walk_can_be_sampled_from_a_buffer() -> None:
    frames = room(60)
    pairs = select(frames, pairs_by_baseline(frames, PairRule()), 10, "poses", 3)
    targets, sources = pairs.sample(4, np.random.default_rng(0))
    assert set(targets) <= set(pairs.targets)
    assert sources.shape == (4, 2)
