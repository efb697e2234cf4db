"""Several processes learn what a single one does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.training import checkpoint as checkpoints

from ..recordings import straight, write_segment
from ..rooms import room
from ..stores import store_of


@pytest.mark.parametrize("network", ["student", "sc_depth_r18"])
def test_two_processes_learn_what_one_learns_from_the_whole_batch(network: str, tmp_path: Path, robot: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write_segment(run / "recording_0000.mcap", room(24), straight(24))
    store = store_of(run, tmp_path / "store", robot, labels=False)
    command = ["train", "--store", str(store.folder), "--network", network, "--batch", "4"]
    command += ["--no-auto-mask", "--steps", "1", "--out"]
    assert main([*command, str(tmp_path / "one")]) == 0
    together = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    together += ["-m", "embodied_depth_trainer", *command, str(tmp_path / "two")]
    subprocess.run(together, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    one, two = (checkpoints.load(tmp_path / name / "checkpoint.pt") for name in ("one", "two"))
    # Adam's first moments are a tenth of the gradients.
    for index, state in one.optimizer["state"].items():
        alone = state["exp_avg"]
        shared = two.optimizer["state"][index]["exp_avg"]
        assert torch.allclose(alone, shared, rtol=1e-3, atol=1e-3 * float(alone.abs().max()) + 1e-7), index
    for name, value in one.weights.items():
        if "running" in name:
            assert torch.allclose(value, two.weights[name], rtol=1e-4, atol=1e-5), name


def test_a_batch_that_cannot_be_divided_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from embodied_depth_trainer import processes
    from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
    from embodied_depth_trainer.errors import TrainerError
    from embodied_depth_trainer.training.settings import Settings
    from embodied_depth_trainer.training.trainer import Trainer

    frames = room(24)
    monkeypatch.setattr(processes, "count", lambda: 2)
    with pytest.raises(TrainerError, match="batch of 3 cannot be divided among 2 processes"):
        Trainer(frames, pairs_by_baseline(frames, PairRule()), Settings(batch=3))
