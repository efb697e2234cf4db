"""Training learns, survives being killed, and stops on errors."""

from __future__ import annotations

import errno
import json
import math
import os
import pickletools
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.batches import (
    ColorChanges,
    coarse_dropout_mask,
    coarse_planes,
    jitter_colors,
    to_depth,
)
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import labels
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.losses.depth_supervision import correctness_nll, label_error, laplace_nll
from embodied_depth_trainer.losses.recipes import recipe
from embodied_depth_trainer.losses.reprojection import LossOptions
from embodied_depth_trainer.studies.evaluation import evaluate
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..recordings import dump_of, straight, write_segment
from ..rooms import room
from ..stores import record, store_of

QUICK = Settings(batch=2, learning_rate=1e-3)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def walk() -> Frames:
    frames = room(24)
    return replace(frames, labels=labels(frames))


def trainer(frames: Frames, settings: Settings = QUICK) -> Trainer:
    return Trainer(frames, pairs_by_baseline(frames, PairRule()), settings)


def weights(file: Path) -> dict[str, torch.Tensor]:
    return checkpoints.load(file).weights


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize(
    "settings",
    [
        QUICK,
        replace(QUICK, loss=LossOptions(geometry=0.1, auto_mask=True)),
        replace(QUICK, label_weight=1.0, crop_width=32, decay=(1, 5)),
        replace(QUICK, network="monodepth2_r18"),
        replace(QUICK, network="monodepth2_r18", amp=True, loss=LossOptions(visibility=True, census=True)),
        replace(QUICK, network="sc_depth_r18", loss=recipe("sc_depth_r18")),
        replace(QUICK, network="manydepth_r18", teacher_steps=3),
        replace(QUICK, network="edn_r18"),
    ],
    ids=[
        "student",
        "geometry and auto-mask",
        "labels and crops",
        "monodepth2_r18",
        "bfloat16, visibility and census",
        "sc_depth_r18",
        "manydepth_r18",
        "edn_r18",
    ],
)
def test_interrupted_training_gives_the_same_bits_as_uninterrupted(
    walk: Frames, settings: Settings, tmp_path: Path
) -> None:
    in_one = train(trainer(walk, settings), 4, tmp_path / "one")
    train(trainer(walk, settings), 2, tmp_path / "two")
    in_two = train(trainer(walk, settings), 4, tmp_path / "two")
    assert same(weights(in_one), weights(in_two))
    assert not same(weights(in_one), trainer(walk, settings).checkpoint().weights)


def test_a_killed_training_continues_to_the_same_bits(tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", room(24), [16, 8])
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    command = ["train", "--store", str(store.folder), "--readers", "2", "--batch", "2", "--seed", "3"]
    command += ["--checkpoint-every", "2", "--out", str(tmp_path / "killed"), "--steps"]
    file = tmp_path / "killed/checkpoint.pt"
    # More steps than it completes before it is killed.
    python = [sys.executable, "-m", "embodied_depth_trainer", *command, "1000000"]
    with subprocess.Popen(python, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
        deadline = time.monotonic() + 100
        while not (file.exists() and checkpoints.load(file).step >= 4) and time.monotonic() < deadline:
            time.sleep(0.01)
        child.send_signal(signal.SIGKILL)
    reached = checkpoints.load(file).step
    assert reached >= 4
    steps = str(reached + 5)
    assert main([*command, steps]) == 0
    assert main([*command, steps, "--out", str(tmp_path / "whole")]) == 0
    assert same(weights(tmp_path / "whole/checkpoint.pt"), weights(file))


def test_a_checkpoint_names_no_module_of_this_package(walk: Frames, tmp_path: Path) -> None:
    """So that checkpoints stay readable when modules move."""
    file = train(trainer(walk), 1, tmp_path)
    with zipfile.ZipFile(file) as archive:
        (pickled,) = (name for name in archive.namelist() if name.endswith("data.pkl"))
        strings = [
            argument for _, argument, _ in pickletools.genops(archive.read(pickled)) if isinstance(argument, str)
        ]
    assert "weights" in strings
    assert not [text for text in strings if "embodied_depth" in text]


def test_a_file_that_names_a_module_of_this_package_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.pt"
    torch.save({"format_version": 1, "settings": QUICK}, file)
    with pytest.raises(TrainerError, match=r"checkpoint\.pt is not a checkpoint: .*train again or give another file"):
        checkpoints.load(file)
    torch.save({"format_version": 99}, file)
    with pytest.raises(TrainerError, match=r"is not a checkpoint of version 1; train again"):
        checkpoints.load(file)


def test_a_checkpoint_of_other_settings_is_refused(walk: Frames, tmp_path: Path) -> None:
    train(trainer(walk), 1, tmp_path)
    with pytest.raises(TrainerError, match=r"learning_rate.*0\.001.*0\.1.*another --out"):
        train(trainer(walk, replace(QUICK, learning_rate=0.1)), 2, tmp_path)


def test_a_loss_that_is_not_finite_stops_training_and_saves_the_samples(walk: Frames, tmp_path: Path) -> None:
    learner = trainer(walk)
    file = train(learner, 2, tmp_path)
    broken = learner.checkpoint()
    broken.weights["head.bias"][0] = torch.nan
    checkpoints.save(broken, file)
    before = file.read_bytes()
    with pytest.raises(TrainerError, match=r"loss of step 2 is nan.*bad_batch\.pt.*lower --learning-rate"):
        train(trainer(walk), 50, tmp_path)
    assert file.read_bytes() == before
    saved = torch.load(tmp_path / "bad_batch.pt", weights_only=True)
    assert saved["targets"].tolist() == learner.batch(2).targets.tolist()
    assert saved["augmented"].shape == (2, 3, 32, 96)


def test_poses_that_are_not_finite_are_refused(walk: Frames) -> None:
    poses = walk.t_world_camera.copy()
    poses[3, 0, 3] = np.nan
    with pytest.raises(TrainerError, match="1 of 24 poses are not finite, the first is 3"):
        Trainer(replace(walk, t_world_camera=poses), pairs_by_baseline(walk, PairRule()), QUICK)


def test_a_full_disk_keeps_the_old_checkpoint(walk: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = train(trainer(walk), 1, tmp_path)
    before = file.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(TrainerError, match=r"No space left.*older checkpoint\.pt is untouched; free some space"):
        train(trainer(walk), 2, tmp_path)
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_an_unwritable_output_is_reported_before_the_first_step(walk: Frames) -> None:
    with pytest.raises(TrainerError, match="cannot write /proc/nowhere"):
        train(trainer(walk), 1, Path("/proc/nowhere"))


def test_networks_with_coarse_input_need_it_and_sizes_must_fit(walk: Frames) -> None:
    with pytest.raises(TrainerError, match="without --coarse none"):
        trainer(replace(walk, coarse=None))
    trainer(replace(walk, coarse=None), replace(QUICK, network="monodepth2_r18"))
    with pytest.raises(TrainerError, match="multiples of 32"):
        trainer(walk.reduced_to((16, 48)))


def test_coarse_planes_equal_those_of_the_robots_runtime() -> None:
    frames = room(1)
    assert frames.coarse is not None
    # The values of the runtime's own test of `write_coarse`.
    frames.coarse[0, 0, 0, :4] = [0, 100, 20_000, 60_000]
    frames.coarse[0, 1, 0, :4] = [0, 32768, 65535, 16384]
    planes = coarse_planes(frames, np.array([0]), (0.1, 20.0))[0, :, 0, :4]
    expected = torch.tensor([[0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 1.0, 1.0], [0.0, 0.5, 1.0, 0.25]])
    assert torch.allclose(planes, expected, atol=1e-4)
    assert torch.allclose(to_depth(planes[0, 1:3], (0.1, 20.0)), torch.tensor([0.1, 20.0]), rtol=1e-5)


def test_the_scale_is_learnt_from_the_distance_to_coarse_depth_and_from_its_confidence() -> None:
    depth = torch.full((1, 1, 4, 4), 2.0)
    coarse = torch.ones(1, 3, 4, 4)
    coarse[:, 0] = (1 / 3.0 - 1 / 20) / (10 - 1 / 20)
    # Correct within 25 % with probability p: ln 1.25 / b = -ln(1 - p).
    coarse[:, 2] = 0.8
    best = math.log(1.5) - math.log(1.25) / math.log(0.2)
    scales = torch.linspace(0.05, 2.0, 400)
    losses = [float(laplace_nll(depth, torch.full_like(depth, float(s)).log(), coarse, (0.1, 20.0))) for s in scales]
    assert float(scales[int(np.argmin(losses))]) == pytest.approx(best, abs=0.01)


def labels_of(depth_m: float, confidence: float) -> torch.Tensor:
    """Labels [1, 2, 2, 2] of an 8x8 image; the first cell has none."""
    planes = torch.tensor([depth_m, confidence]).view(1, 2, 1, 1).repeat(1, 1, 2, 2)
    planes[..., 0, 0] = 0.0
    return planes


def test_labels_are_compared_at_the_middle_of_their_cells() -> None:
    depth = torch.full((1, 1, 8, 8), 9.0)
    depth[..., 2::4, 2::4] = 2.0
    depth[..., 2, 2] = 5.0
    assert float(label_error(depth, labels_of(2.0, 0.9))) == pytest.approx(0.0, abs=1e-6)
    assert float(label_error(2 * depth, labels_of(2.0, 0.9))) == pytest.approx(math.log(2), rel=1e-5)
    assert float(label_error(depth, torch.zeros(1, 2, 2, 2))) == 0.0


def test_the_most_likely_scale_gives_the_share_of_correct_depth() -> None:
    depth = torch.tensor([1.0, 1.2, 1.0, 2.0]).view(1, 1, 2, 2).repeat(1, 1, 16, 16)
    label = torch.cat([torch.ones(1, 1, 32, 32), torch.full((1, 1, 32, 32), 0.9)], 1)
    scales = torch.linspace(0.05, 1.0, 400)
    losses = [float(correctness_nll(depth, torch.full_like(depth, float(s)).log(), label)) for s in scales]
    probability = 1 - math.exp(-math.log(1.25) / float(scales[int(np.argmin(losses))]))
    assert probability == pytest.approx(0.75, abs=0.01)


def test_an_extreme_scale_has_a_finite_loss_and_gradient() -> None:
    depth = torch.full((1, 1, 8, 8), 2.0)
    for scale in (0.01, 2.0):
        for label in (2.0, 7.0):
            log_scale = torch.full_like(depth, math.log(scale)).requires_grad_()
            nll = correctness_nll(depth, log_scale, labels_of(label, 0.9))
            nll.backward()  # type: ignore[no-untyped-call]
            assert log_scale.grad is not None
            assert math.isfinite(float(nll.detach()))
            assert bool(torch.isfinite(log_scale.grad).all())


def test_a_crop_has_its_columns_of_everything_and_warps_like_the_full_image(walk: Frames) -> None:
    learner = trainer(walk)
    whole = learner.batch(0)
    crop = whole.cropped(32, 64)
    assert torch.equal(crop.augmented, whole.augmented[..., 32:])
    assert crop.source_images is whole.source_images
    assert whole.labels is not None
    assert crop.labels is not None
    assert torch.equal(crop.labels, whole.labels[..., 8:])
    depth = torch.full((2, 1, 32, 96), 2.0)
    pose = whole.t_source_target[0]
    cropped = learner.projector(depth[..., 32:], pose, crop.left)
    full = learner.projector(depth, pose)
    assert torch.allclose(cropped.u, full.u[..., 32:], atol=1e-4)
    assert torch.equal(cropped.inside, full.inside[..., 32:])


def test_the_learning_rate_stays_constant_and_then_falls_to_zero() -> None:
    settings = Settings(learning_rate=1.0, decay=(100, 200))
    assert [settings.learning_rate_at(step) for step in (0, 100, 150, 200)] == pytest.approx([1.0, 1.0, 0.5, 0.0])
    assert Settings(learning_rate=1.0).learning_rate_at(10**9) == 1.0
    again = Settings(learning_rate=1.0, cycle=100)
    assert [again.learning_rate_at(step) for step in (0, 50, 100, 150)] == pytest.approx([1.0, 0.5, 1.0, 0.5])


def test_about_half_of_the_images_are_jittered_and_coarse_depth_is_dropped() -> None:
    images = random_image((16, 16), 0).expand(200, -1, -1, -1)
    changed = jitter_colors(images, ColorChanges.draw(200, np.random.default_rng(0)))
    same_ = torch.isclose(changed, images, atol=1e-3).flatten(1).all(1).float().mean()
    assert 0.35 < float(same_) < 0.65
    assert float((changed - images).abs().mean()) < 0.1
    kept = coarse_dropout_mask(torch.Size((500, 3, 32, 64)), np.random.default_rng(0)).flatten(1).mean(1)
    assert 0.1 < float((kept == 0).float().mean()) < 0.2
    assert 0.4 < float((kept == 1).float().mean()) < 0.6


def test_a_short_training_beats_the_constant(tmp_path: Path) -> None:
    frames = room(300)
    unseen = room(40, seed=9)
    settings = Settings(learning_rate=1e-3)
    learner = trainer(frames, settings)
    before = evaluate(unseen, {"student": learner.network}, settings.depth_range_m)
    file = train(learner, 300, tmp_path)
    after = evaluate(unseen, {"student": checkpoints.load(file).build()}, settings.depth_range_m)
    assert after["student"].share == 1.0
    assert after["student"].delta1 > after["constant"].delta1 + 0.1
    # Depth with high confidence is correct.
    assert after["student, mapped"].share > 0.2
    assert after["student, mapped"].delta1_unscaled > max(0.9, after["student"].delta1_unscaled)
    # Measured with this seed: 0.707 before, 0.965 after; with seed 1 0.727, with seed 2 0.937. After 150 steps it was
    # 0.992 on one kind of processor and 0.793 on another.
    assert after["student"].delta1_unscaled > before["student"].delta1_unscaled + 0.1


def test_evaluate_writes_the_numbers_that_it_prints(
    walk: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    coarse = tmp_path / "coarse"
    run.mkdir()
    write_segment(run / "recording_0000.mcap", walk, straight(24), truth=True)
    dump_of(walk, coarse)
    file = train(trainer(walk), 1, tmp_path / "training")
    frames = ["--recording", str(run), "--coarse", str(coarse)]
    assert main(["evaluate", "--checkpoint", str(file), *frames, "--json", str(tmp_path / "rows.json")]) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert list(rows) == [
        "constant",
        "coarse",
        "coarse, holes filled",
        "dense",
        "untrained",
        "untrained, where coarse is",
        "student, 1 steps",
        "student, 1 steps, where coarse is",
    ]
    assert f"{rows['coarse']['delta1']:.3f}" in capsys.readouterr().out
    assert main(["evaluate", "--recording", str(run), "--coarse", str(coarse), "--coarse", str(coarse)]) == 1
    assert "2 --coarse for 1 --recording" in capsys.readouterr().err
