"""The ranks of a Ray cluster learn what those of torchrun learn, also when one of them is lost."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from embodied_depth_trainer import processes
from embodied_depth_trainer.commands import train
from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.checkpoint import Checkpoint
from embodied_depth_trainer.training.trainer import Trainer

from ..clusters import small_cluster
from ..rooms import room
from ..stores import record, without_coarse

# One process runs all tests with a cluster, so that no two clusters compete for the processor (pytest-xdist).
pytestmark = pytest.mark.xdist_group("ray")

STEPS = 4
CHECKPOINT_EVERY = 2
# A rank is lost in the step after this one, which no checkpoint holds.
LOST_AFTER = 3


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A training of a few steps, without its --out."""
    folder = tmp_path_factory.mktemp("walk")
    record(folder / "run", room(24), [24])
    store = without_coarse(folder / "run", folder / "store")
    steps = ["--steps", str(STEPS), "--validate-every", str(STEPS), "--checkpoint-every", str(CHECKPOINT_EVERY)]
    return ["train", "--store", str(store.folder), "--network", "monodepth2_r18", "--batch", "4", *steps]


@pytest.fixture(scope="module")
def by_torchrun(command: list[str], tmp_path_factory: pytest.TempPathFactory) -> Checkpoint:
    """What two ranks of torchrun have learnt."""
    out = tmp_path_factory.mktemp("torchrun")
    words = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    words += ["-m", "embodied_depth_trainer", *command, "--out", str(out)]
    subprocess.run(words, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    return checkpoints.load(out / "checkpoint.pt")


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    with small_cluster():
        yield


def assert_same_bits(one: Checkpoint, two: Checkpoint) -> None:
    assert one.step == two.step == STEPS
    assert one.weights.keys() == two.weights.keys()
    for name, value in one.weights.items():
        assert torch.equal(value, two.weights[name]), name


@pytest.mark.usefixtures("cluster")
def test_two_ranks_of_a_cluster_learn_the_same_bits_as_two_ranks_of_torchrun(
    command: list[str], by_torchrun: Checkpoint, tmp_path: Path
) -> None:
    assert main([*command, "--on", "ray", "--ranks", "2", "--out", str(tmp_path / "out")]) == 0
    assert_same_bits(checkpoints.load(tmp_path / "out/checkpoint.pt"), by_torchrun)
    assert not list((tmp_path / "out").glob(".*"))
    recorded = (tmp_path / "out/experiment.toml").read_text().splitlines()
    assert not [line for line in recorded if line.startswith(("on =", "ranks ="))]


@pytest.mark.usefixtures("cluster")
def test_a_training_that_loses_a_rank_goes_on_to_the_same_bits(
    command: list[str], by_torchrun: Checkpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train, "run_rank", rank_that_is_lost_once)
    assert main([*command, "--on", "ray", "--ranks", "2", "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out/lost").exists()
    assert_same_bits(checkpoints.load(tmp_path / "out/checkpoint.pt"), by_torchrun)


def rank_that_is_lost_once(options: argparse.Namespace, device: str) -> None:
    """Trains as every rank does, but the second one is killed in mid-training when it does so for the first time."""
    advance = Trainer.advance
    lost = options.out / "lost"

    def advance_or_die(trainer: Trainer) -> tuple[float, object]:
        if trainer.step == LOST_AFTER and processes.rank() == 1 and not lost.exists():
            lost.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return advance(trainer)

    # The process is Ray's and ends with the rank.
    Trainer.advance = advance_or_die  # type: ignore[method-assign, assignment]
    train.run_rank(options, device)


@pytest.mark.usefixtures("cluster")
def test_what_the_user_must_correct_ends_the_training_at_once(
    command: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = [*command, "--batch", "3", "--on", "ray", "--ranks", "2", "--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert "error: a batch of 3 cannot be divided among 2 processes" in capfd.readouterr().err


def test_ranks_without_a_cluster_are_refused(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--ranks", "2", "--out", str(tmp_path / "out")]) == 1
    assert "--ranks needs --on ray" in capsys.readouterr().err
