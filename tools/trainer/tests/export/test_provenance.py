"""An exported model says what it was trained on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.export.depth import export_checkpoint
from embodied_depth_trainer.networks.exported import read_metadata
from embodied_depth_trainer.store.dataset import open_dataset, record_version
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.history import TRAINER, continued
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..rooms import room
from ..stores import record, without_coarse

SETTINGS = Settings(network="monodepth2_r18", batch=2)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def trained(store: Store, steps: int, out: Path, settings: Settings = SETTINGS) -> Path:
    """A training on all shards of a store, as `train` does it."""
    dataset = open_dataset([store])
    pairs, _ = find_pairs(dataset, None, PairRule())
    record_version(dataset, out)
    return train(Trainer(dataset.frames, pairs, settings, dataset=dataset.summary), steps, out)


def test_a_model_names_every_dataset_that_it_was_trained_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "runs/monday", room(60), [24, 36], range(1))
    first = open_dataset([without_coarse(tmp_path / "runs", tmp_path / "store")]).version
    trained(Store(tmp_path / "store"), 1, tmp_path / "training")
    record(tmp_path / "runs/monday", room(60), [24, 36], range(1, 2))
    second = open_dataset([without_coarse(tmp_path / "runs", tmp_path / "store")]).version
    capsys.readouterr()
    file = trained(Store(tmp_path / "store"), 2, tmp_path / "training")
    assert f"step 2 on: dataset {second.name}" in capsys.readouterr().err
    model = tmp_path / "model.onnx"
    export_checkpoint(file, None, model)
    metadata = read_metadata(model)[1]
    assert json.loads(metadata["dataset"]) == {
        "version": second.name,
        "shards": 2,
        "frames": 60,
        "runs": 1,
        "every": 1,
    }
    assert metadata["trainer"] == TRAINER
    assert "parent" not in metadata
    capsys.readouterr()
    assert main(["provenance", str(model), "--store", str(tmp_path / "store")]) == 0
    segments = [f"  {(tmp_path / 'runs/monday').resolve()}/recording_000{number}.mcap" for number in range(2)]
    assert capsys.readouterr().out.splitlines() == [
        f"{model}: monodepth2_r18, 32x96",
        "began with: random weights",
        "trained for 2 steps",
        f"steps 1 to 1: dataset {first.name} (24 frames, 1 shard of 1 run), by {TRAINER}",
        f"steps 2 to 2: dataset {second.name} (60 frames, 2 shards of 1 run), by {TRAINER}",
        f"dataset {first.name}:",
        f"{segments[0]}, 24 frames",
        f"dataset {second.name}:",
        f"{segments[0]}, 24 frames",
        f"{segments[1]}, 36 frames",
    ]


def test_a_model_names_the_weights_that_it_began_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "run", room(24), [24])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    parent = trained(store, 1, tmp_path / "parent")
    settings = Settings(network="monodepth2_r18", batch=2, init=str(parent))
    export_checkpoint(trained(store, 1, tmp_path / "child", settings), None, tmp_path / "child.onnx")
    found = read_metadata(tmp_path / "child.onnx")[1]["parent"]
    assert found.startswith("checkpoint.pt sha256:")
    capsys.readouterr()
    assert main(["provenance", str(tmp_path / "child.onnx")]) == 0
    assert f"began with: {found}\n" in capsys.readouterr().out


def test_a_store_that_does_not_know_the_dataset_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "run", room(24), [24])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    export_checkpoint(trained(store, 0, tmp_path / "training"), None, tmp_path / "model.onnx")
    other = without_coarse(tmp_path / "run", tmp_path / "other")
    assert main(["provenance", str(tmp_path / "model.onnx"), "--store", str(other.folder)]) == 1
    assert f"{other.folder} has no list of dataset" in capsys.readouterr().err


def test_a_checkpoint_of_an_earlier_version_is_read_and_continued(tmp_path: Path) -> None:
    record(tmp_path / "run", room(24), [24])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    file = trained(store, 1, tmp_path / "training")
    older = torch.load(file, weights_only=True)
    del older["history"]
    torch.save(older, file)
    assert checkpoints.load(file).history == []
    export_checkpoint(file, None, tmp_path / "older.onnx")
    assert "dataset" not in read_metadata(tmp_path / "older.onnx")[1]
    unknown, known = checkpoints.load(trained(store, 2, tmp_path / "training")).history
    assert unknown == {"from_step": 0}
    assert (known["from_step"], known["shards"]) == (1, 1)


def test_a_period_begins_only_with_another_dataset() -> None:
    one, two = {"version": "a", "every": 1}, {"version": "b", "every": 1}
    history = continued([], 0, one)
    assert continued(history, 5, one) == history
    history = continued(history, 5, two)
    assert [(period["from_step"], period["version"]) for period in history] == [(0, "a"), (5, "b")]
    # No step was made on the second one.
    assert continued(history, 5, one) == continued([], 0, one)


def test_the_shipped_network_says_what_is_known_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    from embodied_depth_trainer.commands.make_default import RUNS
    from embodied_depth_trainer.training.initial import SHIPPED

    assert main(["provenance", str(SHIPPED)]) == 0
    said = capsys.readouterr().out
    assert "began with: raw.onnx sha256:e229debd8ea798f6" in said
    assert f"{len(RUNS)} runs" in said
