"""A study's statistics and report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from embodied_depth_trainer.bootstrap import hierarchical_bootstrap
from embodied_depth_trainer.cli import main
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.jobs import read_jobs
from embodied_depth_trainer.loop_command import parse_job
from embodied_depth_trainer.results import collect, contrasts


def test_a_difference_that_is_always_the_same_is_known_exactly() -> None:
    estimate = hierarchical_bootstrap({"a": [0.1, 0.1], **{home: [0.1] for home in "bcde"}})
    assert (estimate.scenes, estimate.above, estimate.pairs, estimate.verdict) == (5, 5, 6, "holds")
    assert estimate.mean == pytest.approx(0.1)
    assert (estimate.low, estimate.high) == pytest.approx((0.1, 0.1))


def test_the_interval_of_many_scenes_is_that_of_a_mean() -> None:
    random = np.random.default_rng(5)
    values = random.normal(0.3, 0.1, 60)
    estimate = hierarchical_bootstrap({str(scene): [value] for scene, value in enumerate(values)})
    half = 1.96 * values.std() / np.sqrt(60)
    assert estimate.low == pytest.approx(values.mean() - half, abs=0.15 * half)
    assert estimate.high == pytest.approx(values.mean() + half, abs=0.15 * half)


def test_seeds_of_one_scene_do_not_pass_for_many_scenes() -> None:
    scenes = {"a": [0.2] * 50, "b": [-0.1] * 50}
    estimate = hierarchical_bootstrap(scenes)
    assert (estimate.low, estimate.high) == pytest.approx((-0.1, 0.2))
    alone = hierarchical_bootstrap({"a": [0.2] * 50})
    assert (alone.low, alone.verdict) == (None, "undecided: 1 home")


def test_a_few_homes_on_one_side_decide_nothing() -> None:
    few, enough = ({str(home): [sign * 0.1] for home in range(count)} for count, sign in ((4, 1), (5, -1)))
    assert hierarchical_bootstrap(few).verdict == "undecided: 4 homes"
    assert hierarchical_bootstrap(enough).verdict == "fails"


def loop(folder: Path, scene: str, policy: str, network: str, delta1: float, **more: float) -> None:
    """The result of a loop that came to `delta1` on all views, and to 0.1 more after driving."""
    folder.mkdir(parents=True)

    def row(value: float) -> dict[str, float]:
        return {"delta1": value, "delta1_unscaled": value / 2}

    def point(frames: int, value: float) -> dict[str, Any]:
        metrics = {
            part: {network: row(value + better), "constant": row(0.4), **({"coarse": row(0.9)} if better else {})}
            for part, better in (("all", 0.0), ("drive", 0.1), ("turn", 0.0))
        }
        return {"frames": frames, "steps": frames, "metrics": metrics}

    settings = {"scene": scene, "policy": policy, "network": network, "seed": 1, "gap": None, "scale": 0.1, **more}
    result = {"settings": settings, "schedule": {"frames": 10}, "exploration": {"coverage": 0.5}}
    (folder / "result.json").write_text(json.dumps({**result, "curve": [point(0, 0.3), point(10, delta1)]}))


def study(folder: Path) -> Path:
    for scene, better in (("flat", 0.2), ("house", 0.1)):
        for network, base in (("student", 0.5), ("monodepth2_r18", 0.4)):
            loop(folder / f"{scene}{network}r", scene, "random", network, base)
            loop(folder / f"{scene}{network}a", scene, "active", network, base + better)
        loop(folder / f"{scene}gap", scene, "random", "student", 0.45, gap=4)
    return folder


def test_differences_are_paired_by_home_seed_and_network(tmp_path: Path) -> None:
    runs = collect(study(tmp_path / "runs"))
    found = {(row.name, row.part): row.estimate for row in contrasts(runs)}
    active = found["active - random, student", "all"]
    assert active.mean == pytest.approx(0.15)
    assert (active.low, active.high) == pytest.approx((0.1, 0.2))
    assert (active.scenes, active.above) == (2, 2)
    networks = found["student - monodepth2_r18", "drive"]
    assert (networks.mean, networks.pairs) == pytest.approx((0.1, 4))
    assert found["pairs by baseline - 4 frames apart, student, random only", "all"].mean == pytest.approx(0.05)
    assert not any("frontier" in name for name, _ in found), "nothing is said of what was not run"
    unscaled = {(row.name, row.part): row.estimate for row in contrasts(runs, "delta1_unscaled")}
    assert unscaled["active - random, student", "turn"].mean == pytest.approx(0.075)


def test_the_report_is_made_from_the_raw_numbers_alone(tmp_path: Path) -> None:
    out = tmp_path / "results"
    assert main(["results", "--runs", str(study(tmp_path / "runs")), "--out", str(out)]) == 0
    first = (out / "factorial.md").read_text()
    assert "| active | 0.550 | 0.650 | 4 | 0.500 |" in first
    assert "| active - random, student | all | +0.150 | +0.100 to +0.200 | 2 | 2 | 2 | undecided: 2 homes |" in first
    (out / "factorial.md").unlink()
    assert main(["results", "--out", str(out)]) == 0
    assert (out / "factorial.md").read_text() == first
    for figure in ("factorial_policies.png", "factorial_curves.png"):
        assert (out / figure).read_bytes().startswith(b"\x89PNG")


def test_loops_of_different_scales_are_no_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = study(tmp_path / "runs")
    loop(runs / "z", "flat", "forward", "student", 0.5, scale=1.0)
    with pytest.raises(TrainerError, match="each study into its folder"):
        collect(runs)
    assert main(["results", "--out", str(tmp_path / "none")]) == 1
    assert "collect it with --runs" in capsys.readouterr().err


def test_a_printed_job_file_holds_every_combination_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    factors = [
        "--scene",
        "builtin:house?seed=1",
        "--scene",
        "builtin:office",
        "--policy",
        "random",
        "--policy",
        "active",
    ]
    factors += ["--network", "student", "--seed", "1", "--seed", "2", "--out", "runs"]
    assert main(["jobs", *factors, "--", "--scale", "0.02", "--gap", "4"]) == 0
    file = tmp_path / "jobs.txt"
    file.write_text(capsys.readouterr().out)
    jobs = [parse_job(line) for line in read_jobs(file)]
    assert len({(job.scene, job.policy, job.seed, job.out) for job in jobs}) == 8
    assert len({job.out for job in jobs}) == 8
    assert {(job.scale, job.gap) for job in jobs} == {(0.02, 4)}
    assert len({job.views_dir for job in jobs}) == 2
