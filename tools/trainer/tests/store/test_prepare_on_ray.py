"""A store that a Ray cluster prepares is the store that one process prepares, also when workers are lost."""

from __future__ import annotations

import platform
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.shared_folder import check_mark, marked

from ..clusters import small_cluster
from ..rooms import room
from ..stores import calls, record

# One process runs all tests with a cluster, so that no two clusters compete for the processor (pytest-xdist).
pytestmark = pytest.mark.xdist_group("ray")


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    with small_cluster():
        yield


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of three segments."""
    record(tmp_path / "run", room(40), [14, 14, 12])
    return tmp_path / "run"


def prepared(run: Path, out: Path, robot: Path, *options: str) -> dict[str, str]:
    """Prepares the run; returns the digests of all arrays of shards and labels by the names of their folders."""
    assert main(["prepare", str(run), "--out", str(out), "--firmware-host", str(robot), *options]) == 0
    return {str(file.parent.relative_to(out)): file.read_text() for file in sorted(out.glob("*/[!.]*/SHA256SUMS"))}


@pytest.mark.usefixtures("cluster")
def test_a_cluster_of_two_workers_makes_what_one_process_makes(run: Path, tmp_path: Path, robot: Path) -> None:
    alone = prepared(run, tmp_path / "alone", robot)
    together = prepared(run, tmp_path / "together", robot, "--on", "ray")
    assert len(alone) == 6
    assert together == alone
    assert not list((tmp_path / "together").rglob(".*"))


@pytest.mark.usefixtures("cluster")
def test_a_job_whose_worker_is_killed_is_done_again(run: Path, tmp_path: Path, robot: Path) -> None:
    killer = kills_its_first_caller(robot)
    together = prepared(run, tmp_path / "together", killer, "--on", "ray")
    assert (tmp_path / "killed").is_dir()
    assert calls(robot) == 3
    assert together == prepared(run, tmp_path / "alone", robot)


def kills_its_first_caller(robot: Path) -> Path:
    """A program that kills the worker that calls it to compute something, once, and then does what the robot does."""
    folder = robot.parent / "killer"
    folder.mkdir()
    program = folder / "firmware-host"
    program.write_text(
        f"""#!/bin/sh
if [ "$1" = perceive ] && mkdir {robot.parent}/killed 2>/dev/null; then kill -9 $PPID; exit 1; fi
exec {robot} "$@"
"""
    )
    program.chmod(0o755)
    return program


@pytest.mark.usefixtures("cluster")
def test_what_a_worker_cannot_read_is_named_with_its_node(
    run: Path, tmp_path: Path, robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    broken.write_text('#!/bin/sh\nif [ "$1" = --version ]; then echo 0; exit; fi\necho no engine here\nexit 3\n')
    broken.chmod(0o755)
    words = ["prepare", str(run), "--out", str(tmp_path / "store"), "--firmware-host", str(broken), "--on", "ray"]
    assert main(words) == 1
    assert f"error: node {platform.node()}: `{broken} perceive" in capsys.readouterr().err


def test_a_node_that_has_another_folder_is_refused(tmp_path: Path) -> None:
    with marked(tmp_path / "store") as mark:
        check_mark(mark)
        # What a node without the shared file system sees: the folder may be there, with something else in it.
        shutil.rmtree(mark)
        with pytest.raises(
            TrainerError, match=rf"node \S+ of the Ray cluster does not see the directory {mark.parent}"
        ):
            check_mark(mark)
    assert not list((tmp_path / "store").iterdir())


def test_without_ray_the_package_to_install_is_named(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # With this entry, `import ray` fails as if the package were missing.
    monkeypatch.setitem(sys.modules, "ray", None)
    words = ["prepare", str(run), "--out", str(tmp_path / "store"), "--coarse", "none", "--on", "ray"]
    assert main(words) == 1
    assert "--on ray needs Ray; run `pip install -e 'tools/trainer[ray]'` in the checkout" in capsys.readouterr().err


def test_workers_of_this_computer_and_a_cluster_exclude_each_other(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["prepare", str(run), "--out", str(tmp_path / "store"), "--coarse", "none", "--on", "ray", "--workers", "2"]
    assert main(words) == 1
    assert "omit --workers" in capsys.readouterr().err
