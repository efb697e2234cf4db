"""Networks that are given dense depth instead of coarse depth."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from embodied_depth_trainer.data.held_out import only_held_out
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.depth import export_checkpoint
from embodied_depth_trainer.networks.inputs import given_depth_of, second_input
from embodied_depth_trainer.networks.runtime import OnnxNetwork
from embodied_depth_trainer.studies.evaluation import evaluate
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.initial import given_depth
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer
from embodied_depth_trainer.training.validation import Validation

from ..rooms import room

DENSE = Settings(batch=2, given_depth="dense")
RANGE_M = (0.1, 20.0)


def trainer(settings: Settings = DENSE) -> Trainer:
    frames = room(12)
    return Trainer(frames, pairs_by_baseline(frames, PairRule()), settings)


def test_a_training_on_dense_depth_gives_it_whole_and_keeps_images_augmented() -> None:
    batch = trainer().batch(0)
    assert (batch.coarse[:, 1] == 1).all()
    assert torch.equal(batch.coarse, batch.coarse_full)


def test_validation_says_how_often_dense_depth_is_right_where_coarse_depth_is_missing() -> None:
    frames = room(12)
    assert frames.truth_mm is not None
    truth = frames.truth_mm[:, 2::4, 2::4]
    frames = dataclasses.replace(frames, labels=np.stack([truth, np.full_like(truth, 65535)], 1))
    training = Trainer(frames, pairs_by_baseline(frames, PairRule()), dataclasses.replace(DENSE, label_weight=1.0))
    held = dataclasses.replace(frames, held_out=np.ones(12, np.bool_))
    measured = Validation(only_held_out(held, pairs_by_baseline(frames, PairRule()), 4)).measure(training)
    assert 0 <= measured.right_in_holes < measured.right


def test_frames_without_dense_depth_are_refused_with_the_way_out() -> None:
    frames = dataclasses.replace(room(12), dense=None)
    with pytest.raises(TrainerError, match="prepare the recordings again"):
        Trainer(frames, pairs_by_baseline(frames, PairRule()), DENSE)


def test_an_exported_network_says_what_it_is_given_and_is_evaluated_with_it(tmp_path: Path) -> None:
    checkpoint = trainer().checkpoint()
    checkpoints.save(checkpoint, tmp_path / "checkpoint.pt")
    export_checkpoint(tmp_path / "checkpoint.pt", None, tmp_path / "student.onnx")
    network = OnnxNetwork(tmp_path / "student.onnx")
    assert network.metadata["given_depth"] == "dense"
    assert given_depth_of(network) == given_depth_of(checkpoint.build()) == "dense"
    frames = room(4)
    given = second_input(network, frames, np.arange(4), RANGE_M)
    assert (given[:, 1] == 1).all()
    # Untrained, it returns dense depth.
    rows = evaluate(frames, {"network": network}, RANGE_M)
    assert rows["network"].right == pytest.approx(rows["dense"].right, abs=0.02)
    assert rows["network"].right > rows["coarse"].right
    # Joined with what it returns unchanged, it is as right as before.
    assert rows["network, joined with dense"].right == pytest.approx(rows["network"].right, abs=0.02)


def test_a_network_on_coarse_depth_says_so(tmp_path: Path) -> None:
    checkpoint = trainer(Settings(batch=2)).checkpoint()
    checkpoints.save(checkpoint, tmp_path / "checkpoint.pt")
    export_checkpoint(tmp_path / "checkpoint.pt", None, tmp_path / "student.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "student.onnx"), providers=["CPUExecutionProvider"])
    assert session.get_modelmeta().custom_metadata_map["given_depth"] == "coarse"


def test_a_training_that_goes_on_from_a_network_is_given_what_the_network_was_given(tmp_path: Path) -> None:
    checkpoints.save(trainer().checkpoint(), tmp_path / "checkpoint.pt")
    export_checkpoint(tmp_path / "checkpoint.pt", None, tmp_path / "student.onnx")
    for file in ("checkpoint.pt", "student.onnx"):
        assert given_depth(str(tmp_path / file)) == "dense"
    assert given_depth(None) == "coarse"
