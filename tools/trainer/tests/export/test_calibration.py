"""The calibration of a student's confidence."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import labels
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.calibration import (
    LN_TOLERANCE,
    Calibration,
    Counts,
    apply,
    calibrate,
    fit,
    observe,
    table,
)
from embodied_depth_trainer.networks.student import SCALES, UNCONFIRMED_SCALE

from ..rooms import room

SIZE = (64, 96)
LOG_SCALE = np.linspace(math.log(SCALES[0]), math.log(SCALES[1]), 400)


def probability(log_scale: np.ndarray) -> np.ndarray:
    found: np.ndarray = -np.expm1(-LN_TOLERANCE * np.exp(-log_scale))
    return found


def counts(true: Calibration) -> Counts:
    """Counts of a network that is correct as often as it would predict with the calibration `true`."""
    right = probability(true.slope * LOG_SCALE + true.offset)
    return Counts(LOG_SCALE, 1000 * right, 1000 * (1 - right))


@pytest.mark.parametrize("true", [Calibration(1.0, 0.5), Calibration(0.8, 0.2), Calibration(1.2, 0.9)])
def test_the_fit_finds_how_overconfident_a_network_is(true: Calibration) -> None:
    found = fit(counts(true))
    assert (found.slope, found.offset) == pytest.approx((true.slope, true.offset), abs=0.01)


def test_confidence_without_coarse_depth_never_grows() -> None:
    found = fit(counts(Calibration(1.0, -1.0)))
    unconfirmed = math.log(UNCONFIRMED_SCALE)
    assert found.slope * unconfirmed + found.offset >= unconfirmed - 1e-9


def test_a_network_that_is_never_wrong_cannot_be_calibrated() -> None:
    with pytest.raises(TrainerError, match="more recordings"):
        fit(Counts(LOG_SCALE, np.ones(400), np.zeros(400)))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("model") / "student.onnx"
    assert main(["export-depth", "--network", "student", "--random", "--size", "64x96", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def walk() -> Frames:
    frames = room(24, SIZE)
    return replace(frames, labels=labels(frames))


def run(model: Path) -> np.ndarray:
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(3)
    inputs = {name: torch.rand(1, 3, *SIZE, generator=generator).numpy() for name in ("rgb", "coarse")}
    found: np.ndarray = session.run(None, inputs)[0]
    return found


def test_calibration_changes_the_confidence_and_not_the_depth(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.onnx"
    apply(model, Calibration(1.1, 0.4), 7, out)
    before = run(model)
    after = run(out)
    assert np.array_equal(before[:, 0], after[:, 0])
    assert np.allclose(after[:, 1], 1.1 * before[:, 1] + 0.4, atol=1e-5)
    was, now = ({e.key: e.value for e in onnx.load(str(file)).metadata_props} for file in (model, out))
    assert now.pop("version") == was.pop("version") + "-calibrated"
    assert json.loads(now.pop("calibration")) == {"slope": 1.1, "offset": 0.4, "frames": 7}
    assert now == was
    with pytest.raises(TrainerError, match="export it again"):
        apply(out, Calibration(1.0, 0.0), 7, tmp_path / "twice.onnx")


def test_a_second_calibration_is_the_identity() -> None:
    before = counts(Calibration(0.8, 0.2))
    found = fit(before)
    again = fit(replace(before, log_scale=found.slope * before.log_scale + found.offset))
    assert (again.slope, again.offset) == pytest.approx((1.0, 0.0), abs=0.01)


def test_calibration_compares_predictions_on_recorded_frames_with_labels(
    model: Path, walk: Frames, tmp_path: Path
) -> None:
    found, counted = calibrate(model, walk, tmp_path / "out.onnx")
    assert walk.labels is not None
    assert walk.coarse is not None
    total = (walk.labels[:, 1] / 65535).sum()
    assert counted.right.sum() + counted.wrong.sum() == pytest.approx(total, rel=1e-4)
    # An untrained student predicts coarse depth where it is valid, with which labels agree.
    assert counted.right.sum() > 0.8 * total
    assert found != Calibration(1.0, 0.0)
    assert "before after  right  share" in table(counted, found)


def test_only_a_network_that_predicts_its_error_can_be_calibrated(walk: Frames, tmp_path: Path) -> None:
    out = tmp_path / "edn.onnx"
    assert main(["export-depth", "--network", "edn_r18", "--random", "--size", "64x96", "--out", str(out)]) == 0
    with pytest.raises(TrainerError, match="does not predict the scale of its error"):
        observe(out, walk)
    with pytest.raises(TrainerError, match="prepare the recordings with both"):
        observe(out, replace(walk, labels=None))
