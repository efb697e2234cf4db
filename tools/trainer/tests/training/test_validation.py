"""Validation on held-out places, and the warning that nothing is learnt."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.dataset import VALIDATION_FRAMES, find_pairs
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import CELL
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.losses.recipes import recipe
from embodied_depth_trainer.training.initial import SHIPPED
from embodied_depth_trainer.training.progress import CSV_FILE, PICTURE_FILE, Progress
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train
from embodied_depth_trainer.training.validation import Measured, Validation, verdict

from ..recordings import straight, write_segment
from ..rooms import room
from ..stores import store_of

LABELS = Settings(
    batch=8, learning_rate=2e-3, photometric_weight=0.0, coarse_weight=0.0, label_weight=1.0, uncertainty_weight=0.1
)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def with_truth_as_labels(frames: Frames, noise: float = 0.0) -> Frames:
    """Frames of which every sixth stretch of ten is held out, with labels that are the truth times random factors."""
    assert frames.truth_mm is not None
    depth = frames.truth_mm[:, CELL // 2 :: CELL, CELL // 2 :: CELL] / 1000
    factors = np.random.default_rng(3).normal(0, noise, depth.shape)
    planes = np.stack([(1000 * depth * np.exp(factors)).clip(1, 60_000), np.full(depth.shape, 58_000)], 1)
    return replace(frames, labels=planes.astype(np.uint16), held_out=np.arange(len(frames)) // 10 % 6 == 5)


def trained(frames: Frames, steps: int, out: Path, settings: Settings = LABELS, every: int | None = None) -> Progress:
    pairs, validation = find_pairs(frames, None, PairRule())
    learner = Trainer(frames, pairs, settings)
    with Progress(learner, validation, steps, out, every) as progress:
        train(learner, steps, out, on_step=progress)
    return progress


def test_the_warning_comes_early_where_nothing_can_be_learnt(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    frames = with_truth_as_labels(room(120), noise=0.5)
    assert frames.truth_mm is not None
    # Coarse depth is the truth everywhere, and the labels are noise around it: nothing is better than to pass it on.
    known = np.stack([frames.truth_mm, np.full_like(frames.truth_mm, 65_000)], 1)
    progress = trained(replace(frames, coarse=known), 30, tmp_path, replace(LABELS, augment=False))
    assert progress.verdict is not None
    assert progress.verdict.is_nothing
    said = capfd.readouterr().err
    # Once after half of the steps, and at the end.
    assert said.count("NOTHING IS LEARNT") == 2
    assert "step 15 of 30: NOTHING IS LEARNT: the loss of depth on" in said


def test_no_warning_comes_where_something_is_learnt(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # A third of each image has no coarse depth, and the walls of one room are easily learnt.
    settings = replace(LABELS, learning_rate=1e-3, init=str(SHIPPED))
    progress = trained(with_truth_as_labels(room(240)), 60, tmp_path, settings)
    assert progress.verdict is not None
    assert progress.verdict.has_learnt
    said = capfd.readouterr().err
    assert "NOTHING" not in said
    assert "learnt: the loss of depth on" in said
    first, *_, last = progress.rows
    assert last["right in holes"] > first["right in holes"] + 0.05


def measured(*losses: float) -> Measured:
    return Measured({"labels": float(np.mean(losses))}, np.array(losses), 0.5, 0.5)


def test_a_gain_counts_only_above_its_margin() -> None:
    initial = measured(0.10, 0.20, 0.30, 0.40)
    # The same gain in every frame has no standard error: 1 % of the loss decides.
    assert verdict(initial, measured(0.09, 0.19, 0.29, 0.39)).has_learnt
    assert verdict(initial, measured(0.098, 0.198, 0.298, 0.398)).is_nothing
    assert verdict(initial, initial).is_nothing
    assert verdict(initial, measured(math.nan, 0.1, 0.1, 0.1)).is_nothing
    # A larger mean gain that comes from one frame only may be chance.
    by_chance = verdict(initial, measured(0.10, 0.20, 0.30, 0.20))
    assert not by_chance.has_learnt
    assert not by_chance.is_nothing
    assert "not certain" in str(by_chance)


@pytest.mark.parametrize("network", ["student", "sc_depth_r18", "manydepth_r18"])
def test_a_validation_changes_nothing_and_its_parts_add_up(network: str) -> None:
    frames = replace(room(24), held_out=np.arange(24) < 3)
    pairs, held = find_pairs(frames, None, PairRule())
    settings = Settings(network=network, batch=2, loss=recipe(network))
    learner = Trainer(frames, pairs, settings)
    learner.network.train()
    before = {name: value.clone() for name, value in learner.network.state_dict().items()}
    found = Validation(held).measure(learner)
    assert learner.network.training
    assert all(torch.equal(value, before[name]) for name, value in learner.network.state_dict().items())
    again = Validation(held).measure(learner)
    assert (again.parts, again.right) == (found.parts, found.right)
    assert found.loss == pytest.approx(sum(found.parts.values()))
    assert {"photometric", "smoothness"} <= found.parts.keys()

    def summed(parts: dict[str, Tensor]) -> float:
        return float(sum(float(part.detach()) for part in parts.values()))

    batch = learner.batch(0)
    assert summed(learner.loss_parts(batch)) == pytest.approx(float(learner.loss(batch).detach()), rel=1e-5)


def test_validation_frames_are_held_out_and_few(tmp_path: Path) -> None:
    frames = replace(room(200), held_out=np.arange(200) >= 100)
    pairs, held = find_pairs(frames, None, PairRule())
    assert len(held) == VALIDATION_FRAMES
    assert held.targets.min() >= 100
    assert pairs.targets.max() < 100
    nothing = find_pairs(replace(frames, held_out=np.zeros(200, np.bool_)), None, PairRule())[1]
    assert len(nothing) == 0


def test_a_continued_training_keeps_the_rows_before_it(tmp_path: Path) -> None:
    frames = with_truth_as_labels(room(60))
    trained(frames, 4, tmp_path, every=2)
    trained(frames, 6, tmp_path, every=2)
    rows = list(csv.DictReader((tmp_path / CSV_FILE).read_text().splitlines()))
    assert [row["step"] for row in rows] == ["0", "2", "4", "6"]
    assert {"loss", "validation", "validation: labels", "validation: uncertainty", "right"} <= rows[0].keys()
    assert {"learning rate", "samples per second"} <= rows[0].keys()


def test_train_draws_its_progress_and_says_when_it_cannot_validate(
    tmp_path: Path, robot: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run, out = tmp_path / "run", tmp_path / "out"
    run.mkdir()
    write_segment(run / "recording_0000.mcap", room(24), straight(24, 0.04))
    store = store_of(run, tmp_path / "store", robot)
    command = ["train", "--store", str(store.folder), "--init", "shipped", "--batch", "2"]
    assert main([*command, "--steps", "2", "--out", str(out)]) == 0
    assert "no validation: no frame to measure is in a held-out place" in capfd.readouterr().err
    assert (out / PICTURE_FILE).read_bytes().startswith(b"\x89PNG")
