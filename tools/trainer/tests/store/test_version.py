"""A dataset version is the same shards again, or a refusal that names what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.listing import freeze, segments_of
from embodied_depth_trainer.store.prepare import prepare, prune
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import DATASET_FILE, DatasetVersion, read_version, write_version
from embodied_depth_trainer.training import checkpoint as checkpoints

from ..rooms import room
from ..stores import record, store_of, tools, without_coarse

TRAIN = ["train", "--network", "monodepth2_r18", "--batch", "2", "--device", "cpu"]


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(60)


def all_of(store: Store) -> DatasetVersion:
    return freeze(store, [segment.shard for segment in segments_of(store)])


def test_the_version_of_a_training_is_that_of_the_frozen_store(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "run", walk, [24, 16, 20])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    frozen = all_of(store)
    assert open_dataset([store]).version == frozen
    assert (frozen.summary["shards"], frozen.summary["frames"], frozen.summary["runs"]) == (3, 60, 1)


def test_a_version_depends_on_the_bytes_and_not_on_folders_or_order(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "here/a", walk, [24, 36])
    record(tmp_path / "here/b", room(30, seed=1), [30])
    record(tmp_path / "there/z", walk, [24, 36])
    record(tmp_path / "there/y", room(30, seed=1), [30])
    here = without_coarse(tmp_path / "here", tmp_path / "one")
    there = without_coarse(tmp_path / "there", tmp_path / "two")
    assert all_of(here).name == all_of(there).name
    fewer = freeze(here, [segment.shard for segment in segments_of(here)][1:])
    assert fewer.name != all_of(here).name


def test_other_labels_are_another_version(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24, 36], range(1))
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    (alone,) = (segment.listed() for segment in segments_of(store))
    record(tmp_path / "run", walk, [24, 36], range(1, 2))
    prepare([tmp_path / "run"], store, tools(robot))
    first, _ = (segment.listed() for segment in segments_of(store))
    assert first.digest == alone.digest
    assert first.labels_digest != alone.labels_digest
    versions = [DatasetVersion((store.recipe_digest,), (shard,)) for shard in (alone, first)]
    assert versions[0].name != versions[1].name


def test_a_store_that_has_grown_still_has_the_frozen_version(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24, 16, 20], range(2))
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    frozen = all_of(store)
    write_version(frozen, store.frozen(frozen.name))
    record(tmp_path / "run", walk, [24, 16, 20], range(2, 3))
    prepare([tmp_path / "run"], store, tools(robot))
    # The labels of the first two segments have changed; those that the list names are not pruned.
    assert prune(store) == 0
    again = open_dataset([Store(store.folder)], only=frozen)
    assert again.version == frozen
    assert len(again.frames) == 40
    store.frozen(frozen.name).unlink()
    assert prune(store) == 2
    with pytest.raises(TrainerError, match=r"2 of the 2 shards(.|\n)*recording_0000\.mcap .*labels/.* cannot be read"):
        open_dataset([store], only=frozen)


def test_what_is_missing_damaged_or_different_is_named(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "run", walk, [20, 20, 20])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    frozen = all_of(store)
    missing, damaged, whole = frozen.shards
    store.shard(missing.shard).rename(tmp_path / "elsewhere")
    with pytest.raises(TrainerError, match=r"1 of the 3 shards.*prepare(.|\n)*recording_0000\.mcap .* is missing"):
        open_dataset([store], only=frozen)
    (tmp_path / "elsewhere").rename(store.shard(missing.shard))
    file = store.shard(damaged.shard) / "rgb.npy"
    changed = bytearray(file.read_bytes())
    changed[5000] ^= 4
    file.write_bytes(changed)
    with pytest.raises(TrainerError, match=rf"1 of the 3(.|\n)*{damaged.shard}/rgb\.npy has the digest"):
        open_dataset([store], only=frozen)
    sums = store.shard(whole.shard) / "SHA256SUMS"
    sums.write_text(sums.read_text().replace("0", "1"))
    with pytest.raises(TrainerError, match=r"recording_0002\.mcap .* other digests"):
        open_dataset([store], only=frozen)


def test_a_list_that_was_changed_by_hand_is_refused(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "run", walk, [60])
    file = tmp_path / DATASET_FILE
    write_version(all_of(without_coarse(tmp_path / "run", tmp_path / "store")), file)
    plain = json.loads(file.read_text())
    plain["shards"][0]["digest"] = "0" * 64
    file.write_text(json.dumps(plain))
    with pytest.raises(TrainerError, match=r"dataset\.json was changed"):
        read_version(file)
    file.write_text("[]")
    with pytest.raises(TrainerError, match="catalogue freeze"):
        read_version(file)


def test_a_training_on_its_own_list_gives_the_same_weights(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "runs/monday", walk, [24, 36])
    store = str(without_coarse(tmp_path / "runs", tmp_path / "store").folder)
    out = tmp_path / "training"
    assert main([*TRAIN, "--store", store, "--steps", "2", "--out", str(out)]) == 0
    # What is recorded later is not in the list.
    record(tmp_path / "runs/tuesday", room(30, seed=1), [30])
    without_coarse(tmp_path / "runs", tmp_path / "store")
    for name, only in (("again", ["--only", str(out / DATASET_FILE)]), ("more", [])):
        assert main([*TRAIN, "--store", store, *only, "--steps", "2", "--out", str(tmp_path / name)]) == 0
    first, again, more = (checkpoints.load(tmp_path / name / "checkpoint.pt") for name in ("training", "again", "more"))
    assert first.history == again.history
    assert first.history[0]["frames"] == 60
    assert more.history[0]["frames"] == 90
    assert all(torch.equal(first.weights[key], again.weights[key]) for key in first.weights)
    assert any(not torch.equal(first.weights[key], more.weights[key]) for key in first.weights)


def test_a_query_is_frozen_in_the_order_of_the_segments(
    walk: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("duckdb")
    record(tmp_path / "run", walk, [24, 16, 20])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    out = tmp_path / "dataset.json"
    command = ["catalogue", "freeze", "--store", str(store.folder), "--out", str(out)]
    assert main([*command, "SELECT shard FROM segments WHERE frames > 16 ORDER BY frames"]) == 0
    version = read_version(out)
    assert [shard.segment for shard in version.shards] == ["recording_0000.mcap", "recording_0002.mcap"]
    assert capsys.readouterr().out == f"{out}: dataset {version.name}, 2 shards with 44 frames\n"
    assert read_version(store.frozen(version.name)) == version
    assert main([*command, "SELECT frames FROM segments"]) == 1
    assert "SELECT *" in capsys.readouterr().err
    assert main([*command, "SELECT * FROM segments WHERE frames > 100"]) == 1
    assert "has no shard" in capsys.readouterr().err
