"""The statistics and the report of a study."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.commands.loop import parse_job
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.studies.bootstrap import hierarchical_bootstrap
from embodied_depth_trainer.studies.figures import POLICY_COLORS
from embodied_depth_trainer.studies.jobs import read_jobs
from embodied_depth_trainer.studies.results import contrasts
from embodied_depth_trainer.studies.study import (
    CELLS_FILE,
    COLUMNS,
    POLICY_ORDER,
    SETTINGS_FILE,
    collect,
    read_study,
    write_study,
)


def test_a_constant_difference_has_an_interval_of_zero_width() -> None:
    estimate = hierarchical_bootstrap({"a": [0.1, 0.1], **{home: [0.1] for home in "bcde"}})
    assert (estimate.scenes, estimate.above, estimate.pairs, estimate.verdict) == (5, 5, 6, "holds")
    assert estimate.mean == pytest.approx(0.1)
    assert (estimate.low, estimate.high) == pytest.approx((0.1, 0.1))


def test_the_interval_over_many_scenes_approaches_that_of_a_mean() -> None:
    random = np.random.default_rng(5)
    values = random.normal(0.3, 0.1, 60)
    estimate = hierarchical_bootstrap({str(scene): [value] for scene, value in enumerate(values)})
    half = 1.96 * values.std() / np.sqrt(60)
    assert estimate.low == pytest.approx(values.mean() - half, abs=0.15 * half)
    assert estimate.high == pytest.approx(values.mean() + half, abs=0.15 * half)


def test_seeds_of_one_scene_do_not_count_as_scenes() -> None:
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
    """Writes the result of a loop that reached `delta1` on all views, and 0.1 more after driving."""
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
    assert not any("frontier" in name for name, _ in found), "there is no contrast without runs"
    unscaled = {(row.name, row.part): row.estimate for row in contrasts(runs, "delta1_unscaled")}
    assert unscaled["active - random, student", "turn"].mean == pytest.approx(0.075)


def test_the_report_is_made_from_the_compact_files_alone(tmp_path: Path) -> None:
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


def test_every_policy_has_its_own_colour_whatever_else_a_panel_shows() -> None:
    assert set(POLICY_COLORS) == set(POLICY_ORDER)
    assert len(set(POLICY_COLORS.values())) == len(POLICY_ORDER)


def test_loops_with_different_settings_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = study(tmp_path / "runs")
    loop(runs / "z", "flat", "forward", "student", 0.5, scale=1.0)
    with pytest.raises(TrainerError, match="each study into its folder"):
        collect(runs)
    assert main(["results", "--out", str(tmp_path / "none")]) == 1
    assert "collect the study with --runs" in capsys.readouterr().err


def test_a_printed_job_file_contains_every_combination_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_the_compact_files_restore_every_number(tmp_path: Path) -> None:
    collected = collect(study(tmp_path / "runs"))
    write_study(collected, tmp_path)
    assert read_study(tmp_path) == collected
    rows = (tmp_path / CELLS_FILE).read_text().splitlines()
    assert len(rows) == 1 + sum(len(run.curve) for run in collected.runs)
    assert tuple(rows[0].split(",")) == COLUMNS
    assert not collected.runs[0].has("turn", "coarse")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("scene,policy", "home,policy", "columns of a study"),
        ("active,student,1", "active,student,one", "rows of flat, active, student are damaged"),
        (",0.3,", ",nan,", "not finite"),
        (",10,10,", ",0,10,", "frames do not increase"),
        ("\nhouse", ",7\nhouse", "values instead of"),
    ],
)
def test_damaged_compact_files_are_refused(old: str, new: str, message: str, tmp_path: Path) -> None:
    write_study(collect(study(tmp_path / "runs")), tmp_path)
    file = tmp_path / CELLS_FILE
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(TrainerError, match=message):
        read_study(tmp_path)


def test_missing_and_damaged_settings_of_a_study_are_named(tmp_path: Path) -> None:
    write_study(collect(study(tmp_path / "runs")), tmp_path)
    (tmp_path / SETTINGS_FILE).write_text("{")
    with pytest.raises(TrainerError, match="not valid JSON"):
        read_study(tmp_path)
    (tmp_path / SETTINGS_FILE).unlink()
    with pytest.raises(TrainerError, match=r"factorial_settings\.json does not exist; collect the study with --runs"):
        read_study(tmp_path)
