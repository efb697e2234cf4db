"""Segments are prepared once each, on their own, and again only if they or the recipe change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.recording import read_segment
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder
from embodied_depth_trainer.store.complete import COMPLETE_FILE
from embodied_depth_trainer.store.dataset import open_dataset, open_shard
from embodied_depth_trainer.store.prepare import prepare, prune
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import calls, record, store_of, tools, without_coarse


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(40)


def content(store: Store) -> dict[str, bytes]:
    """All files of the store but the lists of segments and what is known of them, which hold times of modification."""
    files = [file for file in store.folder.rglob("*") if file.is_file() and "runs" not in file.parts]
    files = [file for file in files if file.name != COMPLETE_FILE]
    return {str(file.relative_to(store.folder)): file.read_bytes() for file in files}


def test_a_shard_holds_what_the_segment_says_and_the_robots_coarse_depth(
    walk: Frames, tmp_path: Path, robot: Path
) -> None:
    record(tmp_path / "run", walk, [24, 16])
    store = store_of(tmp_path / "run", tmp_path / "store", robot, labels=False)
    (run,) = store.runs.values()
    for number, entry in enumerate(run.shards):
        read = read_segment(tmp_path / f"run/recording_{number:04d}.mcap").frames
        assert entry.shard is not None
        shard = open_shard(ArrayFolder(store.shard(entry.shard)))
        every = np.arange(len(read))
        assert shard.camera == walk.camera
        assert np.array_equal(shard.rgb[every], read.rgb)
        assert np.array_equal(shard.t_world_camera, read.t_world_camera)
        assert np.array_equal(shard.time_ns, read.time_ns)
        assert shard.held_out is not None
        assert read.held_out is not None
        assert np.array_equal(shard.held_out, read.held_out)
        assert shard.coarse is not None
        assert walk.coarse is not None
        assert np.array_equal(shard.coarse[every], walk.coarse[24 * number :][: len(read)])


def test_images_are_reduced_as_in_memory(walk: Frames, tmp_path: Path, robot: Path) -> None:
    frames = room(36, (64, 192))
    record(tmp_path / "run", frames, [36])
    wanted = replace(tools(robot), recipe=replace(tools(robot).recipe, size=(32, 96), labels=False))
    store = Store.create(tmp_path / "store", wanted.recipe)
    prepare([tmp_path], store, wanted)
    small = frames.reduced_to((32, 96))
    found = open_dataset([store]).frames
    assert found.camera == small.camera
    assert np.array_equal(found.rgb[np.arange(36)], small.rgb)
    assert found.coarse is not None
    assert small.coarse is not None
    assert np.array_equal(found.coarse[np.arange(36)], small.coarse)


def test_what_exists_is_not_made_again(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24, 16], range(1))
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    before = content(store)
    assert calls(robot) == 1
    again = Store.create(tmp_path / "store", tools(robot).recipe)
    report = prepare([tmp_path / "run"], again, tools(robot))
    assert (report.segments, report.labelled, calls(robot)) == (0, 0, 1)
    record(tmp_path / "run", walk, [24, 16], range(1, 2))
    report = prepare([tmp_path / "run"], again, tools(robot))
    # The labels of the first segment are completed by what its neighbour has seen.
    assert (report.segments, report.labelled, calls(robot)) == (1, 2, 2)
    after = content(store)
    assert {name: after[name] for name in before} == before


def test_the_robots_program_is_asked_for_restarts_and_a_store_keeps_its_recipe(
    walk: Frames, tmp_path: Path, robot: Path
) -> None:
    record(tmp_path / "run", walk, [24])
    command = ["prepare", str(tmp_path / "run"), "--firmware-host", str(robot), "--out"]
    assert main([*command, str(tmp_path / "restarts")]) == 0
    assert main([*command, str(tmp_path / "memory"), "--restart-every", "0"]) == 0
    first, second = robot.with_name("firmware-host.calls").read_text().splitlines()
    assert "--restart-every 10" in first
    assert "--restart-every" not in second
    # Stores that were made before restarts existed keep the names of their shards.
    assert "restart_every" not in Store(tmp_path / "memory").recipe
    assert Store(tmp_path / "memory").recipe_digest == tools(robot).recipe.digest
    for folder, recipe in (
        ("restarts", tools(robot).recipe),
        ("memory", replace(tools(robot).recipe, restart_every=10)),
    ):
        with pytest.raises(TrainerError, match="restart_every"):
            Store.create(tmp_path / folder, recipe)


def test_a_moved_recording_costs_reading_but_no_computing(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24])
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    (tmp_path / "run").rename(tmp_path / "moved")
    prepare([tmp_path / "moved"], store, tools(robot))
    assert calls(robot) == 1
    # A segment in two lists is used once.
    assert len(open_dataset([store]).frames) == 24


def test_any_number_of_workers_gives_the_same_bytes(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [16, 16, 8])
    one = store_of(tmp_path / "run", tmp_path / "one", robot)
    two = Store.create(tmp_path / "two", tools(robot).recipe)
    prepare([tmp_path / "run"], two, tools(robot, workers=2))
    assert content(one) == content(two)


def test_an_interrupted_preparation_continues_to_the_same_bytes(
    walk: Frames, tmp_path: Path, robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "run", walk, [24, 16])
    whole = store_of(tmp_path / "run", tmp_path / "whole", robot)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Store, "keep", killed)
        with pytest.raises(KeyboardInterrupt):
            store_of(tmp_path / "run", tmp_path / "store", robot)
    before = calls(robot)
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    # The first shard was complete before the interruption.
    assert calls(robot) == before + 1
    assert content(store) == content(whole)


def test_a_segment_that_is_cut_is_named_and_read_up_to_the_damage(walk: Frames, tmp_path: Path) -> None:
    record(tmp_path / "run", walk, [24, 16])
    file = tmp_path / "run/recording_0000.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    (run,) = store.runs.values()
    cut, whole = run.shards
    assert 0 < cut.frames < 24
    assert whole.frames == 16
    assert cut.damage is not None
    assert whole.damage is None


def test_a_segment_without_a_frame_is_named_and_the_others_are_prepared(
    walk: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", walk, [24, 16])
    (tmp_path / "run/recording_0000.mcap").write_bytes(b"not a recording")
    command = ["prepare", str(tmp_path / "run"), "--out", str(tmp_path / "store"), "--coarse", "none"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert "recording_0000.mcap" in said.err
    assert "holds no frame" in said.err
    assert "16 frames; 2 segments were new" in said.out
    assert main(command) == 0
    assert "16 frames; 0 segments were new" in capsys.readouterr().out


def test_a_segment_that_is_still_written_waits(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24, 16], range(1))
    file = tmp_path / "run/recording_0000.mcap"
    complete = file.read_bytes()
    file.write_bytes(complete[:-100])
    wanted = tools(robot)
    store = Store.create(tmp_path / "store", wanted.recipe)
    assert prepare([tmp_path], store, wanted, growing=True).segments == 0
    # Once the next segment exists, the robot does not write this one any more.
    record(tmp_path / "run", walk, [24, 16], range(1, 2))
    assert prepare([tmp_path], store, wanted, growing=True).segments == 2
    assert store.frames == 40
    file.write_bytes(complete)
    assert prepare([tmp_path], store, wanted, growing=True).segments == 1
    assert store.frames == 40


def test_another_recipe_needs_another_store(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24])
    store_of(tmp_path / "run", tmp_path / "store", robot, labels=False)
    with pytest.raises(TrainerError, match=r"made with .*'labels': False.* now .*'labels': True.*another --out"):
        Store.create(tmp_path / "store", tools(robot).recipe)
    newer = robot.read_text().replace("firmware-host 0.0.0", "firmware-host 0.0.1")
    robot.write_text(newer)
    with pytest.raises(TrainerError, match=r"firmware-host 0\.0\.0.*firmware-host 0\.0\.1"):
        Store.create(tmp_path / "store", tools(robot, labels=False).recipe)


def test_what_is_damaged_is_made_again_on_request(
    walk: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", walk, [24, 16])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    before = content(store)
    file = next(store.folder.glob("shards/*/rgb.npy"))
    changed = bytearray(file.read_bytes())
    changed[-1] ^= 1
    file.write_bytes(changed)
    command = ["prepare", str(tmp_path / "run"), "--out", str(store.folder), "--coarse", "none"]
    assert main([*command, "--check"]) == 0
    assert f"made again: {file}" in capsys.readouterr().err
    assert content(store) == before


def test_only_what_no_list_names_is_pruned(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24, 16], range(1))
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    record(tmp_path / "run", walk, [24, 16], range(1, 2))
    prepare([tmp_path], store, tools(robot))
    expected = store_of(tmp_path / "run", tmp_path / "expected", robot)
    assert len(list(store.folder.glob("labels/*"))) == 3
    assert prune(store) == 1
    assert content(store) == content(expected)


def test_a_robot_program_that_fails_is_named_with_its_last_lines(walk: Frames, tmp_path: Path, robot: Path) -> None:
    record(tmp_path / "run", walk, [24])
    wanted = tools(robot)
    store = Store.create(tmp_path / "store", wanted.recipe)
    robot.write_text("#!/bin/sh\necho no such camera >&2\nexit 3\n")
    with pytest.raises(TrainerError, match=r"perceive.*failed with 3; its last lines are\nno such camera"):
        prepare([tmp_path / "run"], store, wanted)
    assert list(store.folder.glob("shards/*")) == []


def test_a_source_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match="nowhere is no directory"):
        without_coarse(tmp_path / "nowhere", tmp_path / "store")
