"""Labels reach across the segments of a run, and a run that grows keeps those that cannot change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import EVERY, MAX_GAP, labels
from embodied_depth_trainer.store import labels as stored
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.manifest import Entry
from embodied_depth_trainer.store.prepare import prepare
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import record, store_of, tools

LENGTH = 56
SEGMENTS = 5


@pytest.fixture(scope="module")
def walk() -> Frames:
    return room(LENGTH * SEGMENTS)


def of(store: Store) -> NDArray[np.uint16]:
    frames = open_dataset([store]).frames
    assert frames.labels is not None
    return frames.labels[np.arange(len(frames))]


def test_labels_of_segments_are_those_of_the_whole_run(walk: Frames, tmp_path: Path, robot: Path) -> None:
    # The same frames vote, because the lengths of the segments are multiples of the step between two voters.
    assert LENGTH % EVERY == 0
    assert MAX_GAP > LENGTH
    record(tmp_path / "run", walk, [LENGTH] * SEGMENTS)
    store = store_of(tmp_path / "run", tmp_path / "store", robot)
    frames = open_dataset([store]).frames
    assert np.array_equal(of(store), labels(frames))


def test_a_run_that_grows_gets_the_labels_of_the_whole_run_and_keeps_those_out_of_reach(
    walk: Frames, tmp_path: Path, robot: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = tools(robot)
    store = Store.create(tmp_path / "store", wanted.recipe)
    computed: list[int] = []
    compute = labels

    def counted(frames: Frames, targets: NDArray[np.int64], voters: NDArray[np.int64]) -> NDArray[np.uint16]:
        computed.append(len(targets))
        return compute(frames, targets, voters)

    monkeypatch.setattr(stored, "labels", counted)
    new = []
    for number in range(SEGMENTS):
        record(tmp_path / "run", walk, [LENGTH] * SEGMENTS, range(number, number + 1))
        computed.clear()
        prepare([tmp_path / "run"], store, wanted)
        new.append(sum(computed))
    # Its own frames and those that a following frame reaches.
    reached = [min(MAX_GAP, LENGTH * number) for number in range(SEGMENTS)]
    assert new == [LENGTH + frames for frames in reached]
    record(tmp_path / "whole", walk, [LENGTH] * SEGMENTS)
    assert np.array_equal(of(store), of(store_of(tmp_path / "whole", tmp_path / "second", robot)))


def test_the_halo_is_as_many_neighbours_as_the_voters_gap_reaches() -> None:
    entries = [Entry(f"recording_{n:04d}.mcap", 0, 0, "", f"s{n}", frames) for n, frames in enumerate([50, 100, 30, 9])]
    assert stored.halo(entries, 0) == ((), ("s1", "s2"))
    assert stored.halo(entries, 2) == (("s0", "s1"), ("s3",))
    assert stored.halo(entries, 3) == (("s1", "s2"), ())
