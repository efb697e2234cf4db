"""Frames on which the robot evaluates models are never trained on."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from embodied_depth_trainer.data.held_out import is_held_out, pose_bin, without_held_out
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.data.recording import read_recording
from embodied_depth_trainer.errors import TrainerError

from ..recordings import write_segment
from ..rooms import room
from .test_pairs import frames_at

SHIPPED = Path(__file__).parents[4] / "tests" / "fixtures" / "held_out.json"


def test_robot_and_trainer_hold_out_the_same_frames() -> None:
    rows = json.loads(SHIPPED.read_text())
    assert len(rows) >= 500
    for row in rows:
        pose = row["x_m"], row["y_m"], row["yaw_rad"]
        assert (list(pose_bin(*pose)), is_held_out(*pose)) == (row["bin"], row["held_out"]), row


def test_about_a_tenth_of_all_places_is_held_out() -> None:
    held = [
        is_held_out(x + 0.5, y + 0.5, 0.1 + s * math.tau / 8) for x in range(30) for y in range(30) for s in range(8)
    ]
    assert 0.08 < np.mean(held) < 0.12


def test_neither_targets_nor_sources_are_held_out() -> None:
    frames = frames_at(list(np.arange(12) * 0.05))
    pairs = pairs_by_baseline(frames, PairRule())
    held = np.zeros(12, np.bool_)
    held[4:7] = True
    kept = without_held_out(replace(frames, held_out=held), pairs)
    used = {
        *kept.targets.tolist(),
        *(int(s) for side in (kept.earlier, kept.later) for sources in side for s in sources),
    }
    assert used.isdisjoint({4, 5, 6})
    assert 0 < len(kept) < len(pairs)


def test_pairs_are_unchanged_if_nothing_is_held_out() -> None:
    frames = frames_at(list(np.arange(12) * 0.05))
    pairs = pairs_by_baseline(frames, PairRule())
    assert without_held_out(frames, pairs) is pairs
    with pytest.raises(TrainerError, match="more places"):
        without_held_out(replace(frames, held_out=np.ones(12, np.bool_)), pairs)


def test_recorded_frames_are_held_out_by_the_pose_of_the_base(tmp_path: Path) -> None:
    wheels = [{"x_m": 0.5 * index, "y_m": 3.0, "yaw_rad": 1.0} for index in range(40)]
    write_segment(tmp_path / "recording_0000.mcap", room(40), wheels)
    frames, _ = read_recording(tmp_path)
    assert frames.held_out is not None
    assert frames.held_out.tolist() == [is_held_out(w["x_m"], w["y_m"], w["yaw_rad"]) for w in wheels]
    assert 0 < frames.held_out.sum() < 40


def test_places_are_compared_in_the_corrected_map(tmp_path: Path) -> None:
    wheels = [{"x_m": 0.5 * index, "y_m": 3.0, "yaw_rad": 1.0} for index in range(40)]
    t_map_odom = {"x_m": 2.0, "y_m": -3.0, "yaw_rad": 0.0}
    write_segment(tmp_path / "recording_0000.mcap", room(40), wheels, t_map_odom=t_map_odom)
    frames, _ = read_recording(tmp_path)
    assert frames.held_out is not None
    assert frames.held_out.tolist() == [is_held_out(0.5 * index + 2.0, 0.0, 1.0) for index in range(40)]
