"""Exports of a real recording, compared with it by programs of other people, which share no code with the exports."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main

from .segments import closing_tick, full_ticks, write_run

REPOSITORY = Path(__file__).resolve().parents[4]
RECORDING = REPOSITORY / "firmware-host/tests/reproducers/stop_zone.mcap"
PEERS = REPOSITORY / "tests/peers"


def convert(run: Path, layout: str, to: Path) -> None:
    assert main(["convert", str(run), "--as", layout, "--out", str(to)]) == 0


def compare(python: str, script: str, exported: Path, *recordings: Path) -> str:
    """What the program prints."""
    command = [python, str(PEERS / script), str(exported), *map(str, recordings)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_foxgloves_reader_reads_from_a_bag_what_the_mcap_package_reads_from_the_recording(tmp_path: Path) -> None:
    convert(RECORDING, "ros2", tmp_path / "bag")
    counts = json.loads(compare(sys.executable, "ros2_bag.py", tmp_path / "bag", RECORDING))
    assert sum(counts.values()) == 121


@pytest.fixture
def lerobot() -> str:
    """A Python with the packages lerobot and mcap."""
    python = os.environ.get("LEROBOT_PYTHON")
    if python is None:
        pytest.skip("LEROBOT_PYTHON names no Python with the packages lerobot and mcap")
    return python


def test_lerobots_own_class_reads_the_same_data_as_the_recording(lerobot: str, tmp_path: Path) -> None:
    convert(RECORDING, "lerobot", tmp_path / "dataset")
    said = compare(lerobot, "lerobot_dataset.py", tmp_path / "dataset", RECORDING)
    assert said.startswith("19 frames in 1 episodes equal the recording")


def test_lerobots_own_class_reads_episodes_and_several_segments(lerobot: str, tmp_path: Path) -> None:
    ticks = [tick.at(tick.time_ns + at // 70 * 5_000_000_000) for at, tick in enumerate(full_ticks(150))]
    segments = write_run(tmp_path / "run", [ticks[:100], [*ticks[100:], closing_tick(ticks[-1])]])
    convert(tmp_path / "run", "lerobot", tmp_path / "dataset")
    said = compare(lerobot, "lerobot_dataset.py", tmp_path / "dataset", *segments)
    assert said.startswith("148 frames in 3 episodes equal the recording")
