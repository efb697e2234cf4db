"""The tables and figures of a study, made only from the files that `study.py` describes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.studies.bootstrap import Estimate, hierarchical_bootstrap
from embodied_depth_trainer.studies.figures import draw_curves, draw_policies
from embodied_depth_trainer.studies.study import BASELINES, CELLS_FILE, Run, Study

TABLE_FILE = "factorial.md"
METRICS = {"delta1": "median-scaled", "delta1_unscaled": "without scaling"}
VIEWS = {"all": "all", "drive": "after driving", "turn": "after a rotation on the spot"}


@dataclass(frozen=True)
class Contrast:
    """A mean difference between two kinds of runs."""

    name: str
    part: str
    """The views that it is measured on."""
    estimate: Estimate


@dataclass(frozen=True)
class _Comparison:
    """Two values of one factor, compared between runs that are equal in `by`."""

    name: str
    part: str
    factor: str
    one: Any
    other: Any
    by: tuple[str, ...]
    network: str | None = None
    policy: str | None = None

    def includes(self, run: Run) -> bool:
        """Whether the run has the network and the policy that the comparison is limited to."""
        return self.network in (None, run.network) and self.policy in (None, run.policy)

    def contrast(self, runs: list[Run], metric: str) -> Contrast | None:
        mine = [run for run in runs if self.includes(run)]
        ones = [run for run in mine if getattr(run, self.factor) == self.one]
        others = [run for run in mine if getattr(run, self.factor) == self.other]
        estimate = paired(ones, others, ("scene", "seed", *self.by), self.part, metric)
        return None if estimate is None else Contrast(self.name, self.part, estimate)


def paired(ones: list[Run], others: list[Run], by: tuple[str, ...], part: str, metric: str) -> Estimate | None:
    """Mean difference between runs that are equal in `by`; `None` if there is no such pair."""
    partners = {_key(run, by): run for run in others}
    differences: dict[str, list[float]] = {}
    for run in ones:
        partner = partners.get(_key(run, by))
        if partner is not None:
            differences.setdefault(run.scene, []).append(run.value(part, metric) - partner.value(part, metric))
    return hierarchical_bootstrap(differences) if differences else None


def _key(run: Run, by: tuple[str, ...]) -> tuple[Any, ...]:
    return tuple(getattr(run, name) for name in by)


def contrasts(study: Study, metric: str = "delta1") -> list[Contrast]:
    """The contrasts of `docs/results/expectations.md`, and what follows from them."""
    found = [comparison.contrast(study.main_runs(), metric) for comparison in _before_pairs(study)]
    found += [comparison.contrast(study.runs, metric) for comparison in _pairs(study)]
    found += [comparison.contrast(study.main_runs(), metric) for comparison in _after_pairs()]
    return [contrast for contrast in found if contrast is not None]


def _before_pairs(study: Study) -> list[_Comparison]:
    found = [_policies("active", "random", network, part) for network in study.networks() for part in VIEWS]
    found.append(_policies("frontier", "random", None, "all"))
    found += [_networks(network, None) for network in ("student", "edn_r18", "manydepth_r18", "sc_depth_r18")]
    found += [_networks("manydepth_r18", policy) for policy in ("random", "active")]
    return found


def _pairs(study: Study) -> list[_Comparison]:
    """Pairs by baseline against pairs at a fixed gap."""
    found = []
    for network in study.networks():
        for policy in (None, "random", "active"):
            name = f"pairs by baseline - 4 frames apart, {network}" + (f", {policy} only" if policy else "")
            found.append(_Comparison(name, "all", "by_baseline", True, False, ("policy",), network, policy))
    return found


def _after_pairs() -> list[_Comparison]:
    pairs = (("active", "frontier"), ("heuristic", "random"), ("forward", "random"))
    return [_policies(one, other, None, "all") for one, other in pairs]


def _policies(one: str, other: str, network: str | None, part: str) -> _Comparison:
    name = f"{one} - {other}, {network or 'all networks'}"
    return _Comparison(name, part, "policy", one, other, ("network",), network)


def _networks(one: str, policy: str | None) -> _Comparison:
    other = "monodepth2_r18"
    name = f"{one} - {other}" + (f", {policy} only" if policy else "")
    return _Comparison(name, "drive", "network", one, other, ("policy",), policy=policy)


def tables(study: Study) -> str:
    """All tables as Markdown."""
    shared = ", ".join(f"{key} {value}" for key, value in study.settings.items() if key != "schedule")
    scenes = sorted({run.scene for run in study.runs})
    head = [
        "# Factorial: results",
        "",
        f"Made by `embodied-depth results` from [{CELLS_FILE}]({CELLS_FILE}). The expectations, which were "
        "written before the runs, are in `docs/results/expectations.md`. Simulated homes, no ground truth in the loop, "
        "last checkpoint.",
        "",
        f"{len(study.runs)} loops on {len(scenes)} homes ({', '.join(scenes)}). "
        f"Schedule: {study.settings['schedule']}. Settings: {shared}.",
    ]
    parts = [_policy_table(study, part, metric) for metric in METRICS for part in VIEWS]
    parts += [_contrast_table(study, metric) for metric in METRICS]
    return "\n".join([*head, *(line for part in parts for line in ["", *part]), ""])


def _mean(runs: list[Run], value: Callable[[Run], float]) -> str:
    """The mean over seeds first, then over scenes."""
    by_scene: dict[str, list[float]] = {}
    for run in runs:
        by_scene.setdefault(run.scene, []).append(value(run))
    if not by_scene:
        return "-"
    return f"{sum(sum(v) / len(v) for v in by_scene.values()) / len(by_scene):.3f}"


def _coverage(run: Run) -> float:
    return run.coverage


def _row(name: str, cells: list[str]) -> str:
    return f"| {name} | {' | '.join(cells)} |"


def _policy_table(study: Study, part: str, metric: str) -> list[str]:
    networks = study.networks()
    main = study.main_runs()
    last = partial(Run.value, part=part, metric=metric)
    title = f"delta1 {METRICS[metric]}, views: {VIEWS[part]}"
    head = [_row("", [*networks, "loops", "coverage"]), _row("---", ["---"] * (len(networks) + 2))]
    lines = [f"## {title}", "", *head]
    for policy in study.policies():
        mine = [run for run in main if run.policy == policy]
        cells = [_mean([run for run in mine if run.network == name], last) for name in networks]
        lines.append(_row(policy, [*cells, str(len(mine)), _mean(mine, _coverage)]))
    first = partial(Run.value, part=part, metric=metric, point=0)
    untrained = [_mean([run for run in main if run.network == name], first) for name in networks]
    lines.append(_row("untrained", [*untrained, "", ""]))
    for name in BASELINES:
        known = [run for run in main if run.has(part, name)]
        cell = _mean(known, partial(Run.value, part=part, metric=metric, of=name))
        lines.append(_row(name, [*[cell] * len(networks), "", ""]))
    return lines


def _contrast_table(study: Study, metric: str) -> list[str]:
    lines = [
        f"## Paired differences of delta1 {METRICS[metric]}, with 95 % intervals",
        "",
        "| difference | views | mean | 95 % interval | homes | of them above 0 | pairs | above 0? |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for contrast in contrasts(study, metric):
        estimate = contrast.estimate
        interval = "-" if estimate.low is None else f"{estimate.low:+.3f} to {estimate.high:+.3f}"
        lines.append(
            f"| {contrast.name} | {VIEWS[contrast.part]} | {estimate.mean:+.3f} | {interval} | {estimate.scenes} "
            f"| {estimate.above} | {estimate.pairs} | {estimate.verdict} |"
        )
    return lines


def write_report(study: Study, out: Path) -> None:
    """Writes tables and figures into `out`."""
    write_atomically(tables(study).encode(), out / TABLE_FILE)
    draw_policies(study, out / "factorial_policies.png")
    draw_curves(study, out / "factorial_curves.png")
