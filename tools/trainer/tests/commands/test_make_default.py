"""The default network: its settings, and the shipped model."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.commands.make_default import CALIBRATION_RUNS, RUNS, SETTINGS, STEPS
from embodied_depth_trainer.networks.golden import at_block_centres, golden_inputs, golden_output
from embodied_depth_trainer.training.settings import Settings

FILE = Path(__file__).resolve().parents[4] / "firmware-host/models/default.onnx"
SIZE = (192, 640)


def metadata() -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load(str(FILE)).metadata_props}


def test_reserved_homes_are_not_trained_on() -> None:
    seeds = [re.search(r"seed=(\d+)", run.home) for run in (*RUNS, *CALIBRATION_RUNS)]
    assert all(seed is not None and int(seed.group(1)) >= 10 for seed in seeds)
    assert len({run.folder for run in RUNS}) == len(RUNS)


def test_calibration_homes_are_not_trained_on() -> None:
    assert not {run.home.split("&")[0] for run in RUNS} & {run.home.split("&")[0] for run in CALIBRATION_RUNS}


def test_the_shipped_model_is_small_and_was_made_with_these_settings() -> None:
    assert FILE.stat().st_size < 3e6
    training = json.loads(metadata()["training"])
    plain = json.loads(json.dumps(vars(SETTINGS) | {"loss": vars(SETTINGS.loss)}))
    assert training.pop("steps") == STEPS
    # It goes on from the network that the model card names.
    assert training.pop("init") == "raw.onnx sha256:e229debd8ea798f6"
    del plain["init"]
    # Options that did not exist yet were off.
    off = vars(Settings())
    assert {key: training.get(key, off[key]) for key in plain} == plain


def test_the_shipped_model_reproduces_its_golden_output() -> None:
    inputs = golden_inputs(metadata(), {"rgb": 3, "coarse": 3}, SIZE)
    session = onnxruntime.InferenceSession(str(FILE), providers=["CPUExecutionProvider"])
    found = session.run(None, {name: value.numpy() for name, value in inputs.items()})[0]
    assert np.allclose(at_block_centres(found[0, 0]), golden_output(metadata(), SIZE), atol=1e-4)


def test_a_missing_robot_program_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--robot", str(tmp_path / "firmware-host"), "--work", str(tmp_path), "--out", str(tmp_path / "x.onnx")]
    assert main(["make-default", *arguments]) == 1
    assert "cannot run" in (message := capsys.readouterr().err)
    assert "cargo build --release" in message
