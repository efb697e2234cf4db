"""A training on shards is the training on the same frames in memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.dataset import find_pairs as find_in_memory
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import labels
from embodied_depth_trainer.data.pairs import PairRule, Pairs, pairs_by_baseline
from embodied_depth_trainer.data.recording import read_recording
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store import pair_index
from embodied_depth_trainer.store.dataset import Dataset, open_dataset
from embodied_depth_trainer.store.pair_index import find_pairs, indexed_pairs, pairs_within
from embodied_depth_trainer.store.prepare import prepare
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..rooms import room
from ..stores import record, store_of, tools, without_coarse

QUICK = Settings(batch=2, learning_rate=1e-3, label_weight=1.0)
RULE = PairRule()


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(60)


def in_memory(run: Path, walk: Frames) -> Frames:
    """The frames of a run with their coarse depth and labels."""
    frames = replace(read_recording(run)[0], coarse=walk.coarse)
    return replace(frames, labels=labels(frames))


def same_pairs(one: Pairs, other: Pairs) -> bool:
    def plain(pairs: Pairs) -> list[tuple[int, list[int], list[int]]]:
        sides = zip(pairs.targets, pairs.earlier, pairs.later, strict=True)
        return [(int(target), early.tolist(), late.tolist()) for target, early, late in sides]

    return plain(one) == plain(other)


def weights(dataset: Dataset, readers: int, out: Path, stops: tuple[int, ...] = (6,)) -> dict[str, torch.Tensor]:
    pairs, _ = find_pairs(dataset, None, RULE)
    for steps in stops:
        file = train(Trainer(dataset.frames, pairs, QUICK, readers=readers), steps, out)
    return checkpoints.load(file).weights


def test_the_last_weights_are_those_of_the_frames_in_memory(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24, 16, 20])
    dataset = open_dataset([store_of(tmp_path / "run", tmp_path / "store", robot)])
    frames = in_memory(tmp_path / "run", walk)
    file = train(Trainer(frames, find_in_memory(frames, None, RULE)[0], QUICK), 6, tmp_path / "memory")
    expected = checkpoints.load(file).weights
    for name, readers, stops in (("one", 1, (6,)), ("three", 3, (6,)), ("restarted", 2, (1, 4, 6))):
        found = weights(dataset, readers, tmp_path / name, stops)
        assert all(torch.equal(found[key], expected[key]) for key in expected), name
    assert any(not torch.equal(value, expected[key]) for key, value in weights(dataset, 1, tmp_path, (5,)).items())


def test_every_second_frame_of_each_segment_is_used(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "run", walk, [24, 36])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    half = read_recording(tmp_path / "run")[0].every(2)
    dataset = open_dataset([store], every=2)
    assert np.array_equal(dataset.frames.rgb[np.arange(30)], half.rgb)
    assert np.array_equal(dataset.frames.t_world_camera, half.t_world_camera)
    assert same_pairs(find_pairs(dataset, None, RULE)[0], find_in_memory(half, None, RULE)[0])


def test_a_batch_costs_its_own_memory_however_large_the_set_is(walk: Frames, tmp_path: Path) -> None:
    def peak(folder: str, segments: list[int]) -> tuple[int, int]:
        """Bytes that were in use at most, and bytes of the images of the set."""
        frames = room(sum(segments))
        record(tmp_path / folder / "run", frames, segments)
        dataset = open_dataset([without_coarse(tmp_path / folder, tmp_path / folder / "store")])
        pairs, _ = find_pairs(dataset, None, RULE)
        trainer = Trainer(dataset.frames, pairs, replace(QUICK, network="monodepth2_r18", label_weight=0.0))
        tracemalloc.start()
        for step in range(20):
            trainer.batch(step)
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used, frames.rgb.nbytes

    small, _ = peak("small", [30])
    large, whole = peak("large", [60] * 4)
    assert large < small + 100_000
    assert large < 0.2 * whole


def test_a_damaged_and_a_cut_shard_are_named_and_left_out(
    walk: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", walk, [20, 20, 20])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    (run,) = store.runs.values()
    damaged, cut, whole = (store.shard(entry.shard or "") for entry in run.shards)
    changed = bytearray((damaged / "rgb.npy").read_bytes())
    changed[5000] ^= 4
    (damaged / "rgb.npy").write_bytes(changed)
    (cut / "pose.npy").write_bytes((cut / "pose.npy").read_bytes()[:-8])
    dataset = open_dataset([store])
    said = capsys.readouterr().err
    assert f"left out: {damaged}/rgb.npy has the digest" in said
    assert f"left out: {cut}/pose.npy has" in said
    assert [part.name for part in dataset.parts] == [whole.name]
    assert len(dataset.frames) == 20


def test_a_shard_that_is_cut_during_the_training_is_named(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "run", walk, [60])
    dataset = open_dataset([without_coarse(tmp_path / "run", tmp_path / "store")])
    file = next((tmp_path / "store/shards").glob("*/rgb.npy"))
    file.write_bytes(file.read_bytes()[:20_000])
    trainer = Trainer(dataset.frames, find_pairs(dataset, None, RULE)[0], replace(QUICK, network="monodepth2_r18"))
    with pytest.raises(TrainerError, match=r"rgb\.npy ends before row"):
        train(trainer, 6, tmp_path / "training")


def test_held_out_frames_never_enter_a_training(walk: Frames, tmp_path: Path) -> None:
    frames = room(300, (32, 64), seed=3)
    record(tmp_path / "run", frames, [100, 100, 100])
    dataset = open_dataset([without_coarse(tmp_path / "run", tmp_path / "store")])
    held = dataset.frames.held_out
    assert 0 < held.sum() < len(held)
    pairs, validation = find_pairs(dataset, None, RULE)
    used = np.concatenate([pairs.targets, *pairs.earlier, *pairs.later])
    assert not held[used].any()
    assert held[validation.targets].all()
    assert len(validation) > 0


def test_the_pairs_are_those_of_the_whole_run_and_found_once_for_each_shard(
    walk: Frames, tmp_path: Path, robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = room(200, (32, 64), seed=3)
    found: list[tuple[int, int]] = []

    def counted(frames: Frames, reach: int, begin: int, end: int, rule: PairRule) -> NDArray[np.int64]:
        found.append((begin, end))
        return pairs_within(frames, reach, begin, end, rule)

    monkeypatch.setattr(pair_index, "pairs_within", counted)
    wanted = tools(robot, labels=False)
    wanted = replace(wanted, recipe=replace(wanted.recipe, coarse="none"))
    store = Store.create(tmp_path / "store", wanted.recipe)
    for number in range(4):
        record(tmp_path / "run", frames, [50] * 4, range(number, number + 1))
        prepare([tmp_path / "run"], store, wanted)
        dataset = open_dataset([store])
        pairs = indexed_pairs(dataset, RULE)
        assert same_pairs(pairs, pairs_by_baseline(dataset.frames, RULE))
    assert found == [(0, 50), (50, 100), (100, 150), (150, 200)]


def test_runs_of_several_stores_and_dumps_are_not_related(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "a/run", walk, [24, 16, 20])
    record(tmp_path / "b/run", room(30, seed=1), [30])
    one = without_coarse(tmp_path / "a", tmp_path / "one")
    two = without_coarse(tmp_path / "b", tmp_path / "two")
    assert open_dataset([one, two]).frames.run.tolist() == [0] * 60 + [1] * 30
    again = without_coarse(tmp_path / "b", tmp_path / "one")
    assert set(open_dataset([again]).frames.run.tolist()) == {0, 1}


def test_training_without_a_store_or_on_an_empty_one_says_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", "--steps", "1", "--out", str(tmp_path / "out")]
    assert main(command) == 1
    assert "embodied-depth prepare" in capsys.readouterr().err
    assert main([*command, "--store", str(tmp_path)]) == 1
    assert f"embodied-depth prepare SOURCE --out {tmp_path}" in capsys.readouterr().err
