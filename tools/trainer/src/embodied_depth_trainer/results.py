"""A study of many loops: raw numbers in one file, and tables and figures made from that file alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .bootstrap import Estimate, hierarchical_bootstrap
from .checkpoint import write_atomically
from .errors import TrainerError
from .loop import RESULT_FILE
from .results_figures import draw_curves, draw_policies

RAW_FILE = "factorial.json"
TABLE_FILE = "factorial.md"
# Settings in which the loops of one study may differ.
FACTORS = ("scene", "policy", "network", "seed", "gap")


@dataclass(frozen=True)
class Run:
    """One loop."""

    scene: str
    policy: str
    network: str
    seed: int
    gap: int | None
    coverage: float
    """Share of the reachable floor that was mapped."""
    curve: list[dict[str, Any]]
    """Points with `frames`, `steps` and `metrics`, from the untrained network to the last checkpoint."""

    def value(self, part: str = "all", metric: str = "delta1", of: str | None = None, point: int = -1) -> float:
        """Of the network, or of what it is compared with (`constant`, `coarse`)."""
        return float(self.curve[point]["metrics"][part][of or self.network][metric])


@dataclass(frozen=True)
class Study:
    """Loops that differ in nothing but the factors."""

    settings: dict[str, Any]
    """What they share."""
    runs: list[Run]

    def networks(self) -> list[str]:
        return sorted({run.network for run in self.runs})

    def policies(self) -> list[str]:
        order = ("random", "heuristic", "forward", "inconsistency", "frontier", "active")
        return sorted({run.policy for run in self.runs}, key=order.index)

    def main_runs(self) -> list[Run]:
        """Those of the factorial; pairs a fixed gap apart are a comparison of their own."""
        return [run for run in self.runs if run.gap is None]


def collect(folder: Path) -> Study:
    """All loops below `folder` that are done."""
    files = sorted(folder.rglob(RESULT_FILE))
    if not files:
        raise TrainerError(f"{folder} holds no {RESULT_FILE}; run loops with --out below it")
    shared: dict[str, Any] | None = None
    runs = []
    for file in files:
        result = json.loads(file.read_text())
        settings = {**result["settings"], "schedule": result["schedule"]}
        factors = {key: settings.pop(key) for key in FACTORS}
        if shared not in (None, settings):
            raise TrainerError(f"{file} was made with {settings}, others with {shared}; put each study into its folder")
        shared = settings
        runs.append(Run(**factors, coverage=float(result["exploration"]["coverage"]), curve=result["curve"]))
    return Study(shared or {}, runs)


def write_raw(study: Study, file: Path) -> None:
    text = json.dumps({"settings": study.settings, "runs": [asdict(run) for run in study.runs]}, indent=1)
    write_atomically(text.encode(), file)


def read_raw(file: Path) -> Study:
    try:
        raw = json.loads(file.read_text())
    except FileNotFoundError:
        raise TrainerError(f"{file} does not exist; collect it with --runs DIR") from None
    return Study(raw["settings"], [Run(**run) for run in raw["runs"]])


METRICS = {"delta1": "median-scaled", "delta1_unscaled": "without scaling"}
VIEWS = {"all": "all", "drive": "after driving", "turn": "after a turn on the spot"}
Kind = Callable[[Run], bool]


@dataclass(frozen=True)
class Contrast:
    """A mean difference between two kinds of runs."""

    name: str
    part: str
    """Of the views."""
    estimate: Estimate


def paired(
    runs: list[Run], is_one: Kind, is_other: Kind, by: tuple[str, ...], part: str, metric: str
) -> Estimate | None:
    """Mean difference between two kinds of runs that are alike in `by`; `None` where no two are."""

    def key(run: Run) -> tuple[Any, ...]:
        return tuple(getattr(run, name) for name in by)

    others = {key(run): run for run in runs if is_other(run)}
    differences: dict[str, list[float]] = {}
    for run in runs:
        if is_one(run) and key(run) in others:
            difference = run.value(part, metric) - others[key(run)].value(part, metric)
            differences.setdefault(run.scene, []).append(difference)
    return hierarchical_bootstrap(differences) if differences else None


def contrasts(study: Study, metric: str = "delta1") -> list[Contrast]:
    """Those of `docs/results/expectations.md`, and what follows."""
    main, found = study.main_runs(), []

    def add(name: str, part: str, runs: list[Run], is_one: Kind, is_other: Kind, *by: str) -> None:
        estimate = paired(runs, is_one, is_other, ("scene", "seed", *by), part, metric)
        if estimate is not None:
            found.append(Contrast(name, part, estimate))

    def policies(one: str, other: str, network: str | None, part: str) -> None:
        mine = [run for run in main if network in (None, run.network)]
        name = f"{one} - {other}, {network or 'all networks'}"
        add(name, part, mine, lambda r: r.policy == one, lambda r: r.policy == other, "network")

    def networks(one: str, other: str, policy: str | None = None) -> None:
        mine = [run for run in main if policy in (None, run.policy)]
        name = f"{one} - {other}" + (f", {policy} only" if policy else "")
        add(name, "drive", mine, lambda r: r.network == one, lambda r: r.network == other, "policy")

    def pairs(network: str, policy: str | None = None) -> None:
        mine = [run for run in study.runs if run.network == network and policy in (None, run.policy)]
        name = f"pairs by baseline - 4 frames apart, {network}" + (f", {policy} only" if policy else "")
        add(name, "all", mine, lambda r: r.gap is None, lambda r: r.gap is not None, "policy")

    for network in study.networks():
        for part in VIEWS:
            policies("active", "random", network, part)
    policies("frontier", "random", None, "all")
    for network in ("student", "edn_r18", "manydepth_r18", "sc_depth_r18"):
        networks(network, "monodepth2_r18")
    for policy in ("random", "active"):
        networks("manydepth_r18", "monodepth2_r18", policy)
    for network in study.networks():
        pairs(network)
        pairs(network, "random")
        pairs(network, "active")
    for one, other in (("active", "frontier"), ("heuristic", "random"), ("forward", "random")):
        policies(one, other, None, "all")
    return found


def tables(study: Study) -> str:
    """Everything as Markdown."""
    shared = ", ".join(f"{key} {value}" for key, value in study.settings.items() if key != "schedule")
    scenes = sorted({run.scene for run in study.runs})
    head = [
        "# Factorial: results",
        "",
        f"Made by `embodied-depth results` from [{RAW_FILE}]({RAW_FILE}); what was expected is in "
        "`docs/results/expectations.md`. Simulated homes, no ground truth in the loop, last checkpoint.",
        "",
        f"{len(study.runs)} loops on {len(scenes)} homes ({', '.join(scenes)}). "
        f"Schedule: {study.settings['schedule']}. Settings: {shared}.",
    ]
    parts = [_policy_table(study, part, metric) for metric in METRICS for part in VIEWS]
    parts += [_contrast_table(study, metric) for metric in METRICS]
    return "\n".join([*head, *(line for part in parts for line in ["", *part]), ""])


def _mean(runs: list[Run], value: Callable[[Run], float]) -> str:
    """Over seeds first, then over scenes."""
    by_scene: dict[str, list[float]] = {}
    for run in runs:
        by_scene.setdefault(run.scene, []).append(value(run))
    if not by_scene:
        return "-"
    return f"{sum(sum(v) / len(v) for v in by_scene.values()) / len(by_scene):.3f}"


def _policy_table(study: Study, part: str, metric: str) -> list[str]:
    networks, main = study.networks(), study.main_runs()
    title = f"delta1 {METRICS[metric]}, views: {VIEWS[part]}"

    def row(name: str, cells: list[str]) -> str:
        return f"| {name} | {' | '.join(cells)} |"

    lines = [f"## {title}", "", row("", [*networks, "loops", "coverage"]), row("---", ["---"] * (len(networks) + 2))]
    for policy in study.policies():
        mine = [run for run in main if run.policy == policy]
        cells = [_mean([r for r in mine if r.network == name], lambda r: r.value(part, metric)) for name in networks]
        lines.append(row(policy, [*cells, str(len(mine)), _mean(mine, lambda r: r.coverage)]))
    untrained = [
        _mean([r for r in main if r.network == name], lambda r: r.value(part, metric, point=0)) for name in networks
    ]
    lines.append(row("untrained", [*untrained, "", ""]))
    for name in ("constant", "coarse"):
        known = [run for run in main if name in run.curve[-1]["metrics"][part]]
        cell = _mean(known, lambda r, name=name: r.value(part, metric, of=name))  # type: ignore[misc]
        lines.append(row(name, [*[cell] * len(networks), "", ""]))
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
    """Tables and figures into `out`."""
    write_atomically(tables(study).encode(), out / TABLE_FILE)
    draw_policies(study, out / "factorial_policies.png")
    draw_curves(study, out / "factorial_curves.png")
