"""A watch trains on new recordings, passes networks on, and continues after an interruption."""

from __future__ import annotations

import json
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from embodied_depth_trainer.commands import watch as watching
from embodied_depth_trainer.commands.watch import STATE_FILE, Watch, WatchSettings, watch
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.provenance import Provenance
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.store.recipe import RESTART_EVERY
from embodied_depth_trainer.store.store import Store, restarts_of
from embodied_depth_trainer.store.version import remembered
from embodied_depth_trainer.training import checkpoint as checkpoints

from ..fake_robot import walk, wheels
from ..recordings import write_segment
from ..signing import KITCHEN, ROBOTS, sign
from ..stores import calls, store_of


def pull(folder: Path, run: str, segment: int, count: int = 12) -> None:
    """Adds a segment as pull-buffer does when it is complete."""
    (folder / run).mkdir(parents=True, exist_ok=True)
    frames = walk(0, 0, count * (segment + 1))
    part = replace(
        frames,
        rgb=frames.rgb[-count:],
        t_world_camera=frames.t_world_camera[-count:],
        time_ns=frames.time_ns[-count:],
    )
    write_segment(folder / run / f"recording_{segment:04d}.mcap", part, wheels(part), segment)


@pytest.fixture
def settings(tmp_path: Path, robot: Path) -> WatchSettings:
    received = tmp_path / "received"
    then = shlex.join(
        [sys.executable, "-c", "import sys; open(sys.argv[1], 'a').write(sys.argv[2] + '\\n')", str(received)]
    )
    defaults = WatchSettings(tmp_path / "pulled", tmp_path / "work", robot)
    small = replace(defaults.training, batch=4, crop_width=0)
    return replace(defaults, frames=12, steps=2, every=1, then=f"{then} {{}}", rounds=1, training=small)


def test_every_round_continues_training_on_all_runs_and_passes_on_its_network(
    settings: WatchSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pull(settings.pulled, "robot/monday", 0)
    (first,) = watch(settings)
    training = checkpoints.load(settings.work / "training/checkpoint.pt").settings
    assert training["init"].startswith("default.onnx sha256:")
    # A newer package with another default network does not end a watch.
    monkeypatch.setattr(watching, "SHIPPED", first)
    pull(settings.pulled, "robot/monday", 1)
    pull(settings.pulled, "other/tuesday", 0)
    (second,) = watch(replace(settings, rounds=2))
    assert (tmp_path / "received").read_text().split() == [str(first), str(second)]
    assert first.stat().st_size > 10_000
    assert second.read_bytes() != first.read_bytes()
    assert checkpoints.load(settings.work / "training/checkpoint.pt").step == 4
    assert json.loads((settings.work / STATE_FILE).read_text()) == {"rounds": 2, "frames": 36}


def test_a_watch_that_began_with_random_weights_stays_with_them(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    watch(replace(settings, init="none"))
    pull(settings.pulled, "robot/monday", 1)
    watch(replace(settings, rounds=2))
    saved = checkpoints.load(settings.work / "training/checkpoint.pt")
    assert (saved.settings["init"], saved.step) == (None, 4)


def test_a_watch_that_an_earlier_version_began_keeps_its_store(settings: WatchSettings, robot: Path) -> None:
    pull(settings.pulled, "robot/monday", 0)
    store_of(settings.pulled, settings.work / "store", robot)
    (network,) = watch(settings)
    assert network.exists()
    assert restarts_of(settings.work / "store") is None
    begun_now = replace(settings, work=settings.work.with_name("new"))
    watch(begun_now)
    assert restarts_of(begun_now.work / "store") == RESTART_EVERY


def test_a_watch_goes_on_with_the_losses_that_an_earlier_version_began_with(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    before = replace(settings.training, coarse_weight=0.0, color_change=None)
    watch(replace(settings, training=before))
    pull(settings.pulled, "robot/monday", 1)
    assert settings.training.coarse_weight > 0
    watch(replace(settings, rounds=2))
    saved = checkpoints.load(settings.work / "training/checkpoint.pt")
    assert (saved.step, saved.settings["coarse_weight"], saved.settings["color_change"]) == (4, 0.0, None)


def test_completed_rounds_are_not_repeated(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    watch(settings)
    assert watch(settings) == []


def test_a_refused_network_does_not_end_the_watch(settings: WatchSettings, capfd: pytest.CaptureFixture[str]) -> None:
    pull(settings.pulled, "robot/monday", 0)
    assert len(watch(replace(settings, then="false {}"))) == 1
    assert "ended with 1" in capfd.readouterr().err


def test_a_missing_command_is_named(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    with pytest.raises(TrainerError, match=r"no-such-program.*--then"):
        watch(replace(settings, then="no-such-program {}"))


def test_only_new_segments_are_prepared(settings: WatchSettings, robot: Path) -> None:
    pull(settings.pulled, "robot/monday", 0)
    watch(settings)
    assert calls(robot) == 1
    # A watch that begins again knows what it has.
    pull(settings.pulled, "robot/monday", 1)
    watch(replace(settings, rounds=2))
    assert calls(robot) == 2
    watched = Watch(settings)
    assert watched.look() == 24
    assert calls(robot) == 2


def test_a_segment_without_an_index_counts_only_once_it_is_complete(settings: WatchSettings) -> None:
    pull(settings.pulled, "run", 0)
    file = settings.pulled / "run/recording_0000.mcap"
    complete = file.read_bytes()
    file.write_bytes(complete[:-100])
    watched = Watch(settings)
    assert watched.look() == 0
    file.write_bytes(complete)
    assert watched.look() == 12


def test_a_watch_with_known_robots_counts_only_what_they_signed(
    settings: WatchSettings, capfd: pytest.CaptureFixture[str]
) -> None:
    for number in range(3):
        pull(settings.pulled, "run", number)
    folder = settings.pulled / "run"
    digest = sign(folder / "recording_0000.mcap", KITCHEN)
    sign(folder / "recording_0002.mcap", KITCHEN, "00" * 32)
    watched = Watch(replace(settings, known_robots=ROBOTS))
    assert watched.look() == 24
    said = capfd.readouterr().err
    assert f"{folder}/recording_0001.mcap: refused: unsigned" in said
    assert f"warning: {folder}/recording_0002.mcap does not follow recording_0000.mcap" in said
    assert watched.look() == 24
    assert "refused" not in capfd.readouterr().err
    sign(folder / "recording_0001.mcap", KITCHEN, digest)
    assert watched.look() == 36


def test_frames_that_are_refused_now_do_not_delay_a_round(
    settings: WatchSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_atomically(json.dumps({"rounds": 1, "frames": 100}).encode(), settings.work / STATE_FILE)
    looks = iter([0, 12])
    monkeypatch.setattr(Watch, "look", lambda _: next(looks))
    monkeypatch.setattr(time, "sleep", lambda _: None)
    monkeypatch.setattr(watching, "_round", lambda *_: tmp_path / "model.onnx")
    assert len(watch(replace(settings, rounds=2))) == 1


def test_a_directory_that_does_not_exist_yet_holds_no_frames(settings: WatchSettings) -> None:
    assert Watch(settings).look() == 0


def test_a_network_names_the_recordings_of_every_round(settings: WatchSettings) -> None:
    pull(settings.pulled, "robot/monday", 0)
    watch(settings)
    pull(settings.pulled, "robot/monday", 1)
    (network,) = watch(replace(settings, rounds=2))
    provenance = Provenance(network)
    assert [(period["from_step"], period["frames"]) for period in provenance.history] == [(0, 12), (2, 24)]
    assert provenance.metadata["parent"].startswith("default.onnx sha256:")
    known = [remembered(name, [Store(settings.work / "store")]) for name in provenance.datasets]
    assert [len(version.shards) for version in known] == [1, 2]
