"""Recordings come in, networks go out, and a watch that was cut goes on."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from embodied_depth_trainer import checkpoint as checkpoints
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.watch import STATE_FILE, WatchSettings, pictures_of, runs, watch

from .fake_robot import walk, wheels
from .recordings import write_segment


def pull(folder: Path, run: str, segment: int, pictures: int = 12) -> None:
    """What pull-buffer does when a segment is whole."""
    (folder / run).mkdir(parents=True, exist_ok=True)
    frames = walk(0, 0, pictures * (segment + 1))
    part = replace(
        frames,
        rgb=frames.rgb[-pictures:],
        t_world_camera=frames.t_world_camera[-pictures:],
        time_ns=frames.time_ns[-pictures:],
    )
    write_segment(folder / run / f"recording_{segment:04d}.mcap", part, wheels(part), segment)


@pytest.fixture
def settings(tmp_path: Path, robot: Path) -> WatchSettings:
    heard = tmp_path / "heard"
    then = shlex.join(
        [sys.executable, "-c", "import sys; open(sys.argv[1], 'a').write(sys.argv[2] + '\\n')", str(heard)]
    )
    usual = WatchSettings(tmp_path / "pulled", tmp_path / "work", robot)
    small = replace(usual.training, batch=4, crop_width=0)
    return replace(usual, pictures=12, steps=2, every=1, then=f"{then} {{}}", rounds=1, training=small)


def test_every_round_trains_on_all_runs_goes_on_and_hands_its_network_over(
    settings: WatchSettings, tmp_path: Path
) -> None:
    pull(settings.pulled, "robot/monday", 0)
    (first,) = watch(settings)
    pull(settings.pulled, "robot/monday", 1)
    pull(settings.pulled, "other/tuesday", 0)
    (second,) = watch(replace(settings, rounds=2))
    assert (tmp_path / "heard").read_text().split() == [str(first), str(second)]
    assert first.stat().st_size > 10_000
    assert second.read_bytes() != first.read_bytes()
    assert checkpoints.load(settings.work / "training/checkpoint.pt").step == 4
    assert json.loads((settings.work / STATE_FILE).read_text()) == {"rounds": 2, "pictures": 36}


def test_what_was_done_is_not_done_again(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    watch(settings)
    assert watch(settings) == []


def test_a_refused_network_is_no_end(settings: WatchSettings, capfd: pytest.CaptureFixture[str]) -> None:
    pull(settings.pulled, "robot/monday", 0)
    assert len(watch(replace(settings, then="false {}"))) == 1
    assert "ended with 1" in capfd.readouterr().err


def test_a_command_that_is_not_there_is_named(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    with pytest.raises(TrainerError, match=r"no-such-program.*--then"):
        watch(replace(settings, then="no-such-program {}"))


def test_a_cut_segment_counts_when_it_is_whole(settings: WatchSettings) -> None:
    pull(settings.pulled, "run", 0)
    assert pictures_of(settings.pulled / "run") == 12
    file = settings.pulled / "run/recording_0000.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    assert pictures_of(settings.pulled / "run") == 0
    assert runs(settings.pulled) == [settings.pulled / "run"]
