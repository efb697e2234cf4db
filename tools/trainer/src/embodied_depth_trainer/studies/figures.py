"""The figures of a study."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from embodied_depth_trainer.studies.plots import save
from embodied_depth_trainer.studies.study import Study

# Okabe and Ito's colours, which eyes that do not tell red from green distinguish, too. A policy has the same colour in
# every panel and every study, whichever policies the study has.
POLICY_COLORS = {
    "random": "#0072b2",
    "active": "#e69f00",
    "frontier": "#009e73",
    "inconsistency": "#cc79a7",
    "heuristic": "#56b4e9",
    "forward": "#d55e00",
}
METRIC_TITLES = {"delta1": "delta1 (median-scaled)", "delta1_unscaled": "delta1 (without scaling)"}


def draw_policies(study: Study, file: Path) -> None:
    """Draws delta1 of every loop as a dot and of every policy's mean as a bar, with one column per network and one row
    per metric."""
    networks = study.networks()
    policies = study.policies()
    figure = Figure((4.2 * len(networks), 6.4), layout="constrained")
    grid = figure.subplots(2, len(networks), squeeze=False, sharey=True)
    for axes, (metric, title) in zip(grid, METRIC_TITLES.items(), strict=True):
        for axis, network in zip(axes, networks, strict=True):
            runs = [run for run in study.main_runs() if run.network == network]
            for place, policy in enumerate(policies):
                values = [run.value(metric=metric) for run in runs if run.policy == policy]
                if values:
                    axis.bar(place, np.mean(values), color="lightsteelblue")
                    axis.plot([place] * len(values), values, "k.", markersize=4)
            if runs:
                constant = np.mean([run.value(metric=metric, of="constant") for run in runs])
                untrained = np.mean([run.value(metric=metric, point=0) for run in runs])
                axis.axhline(constant, color="gray", ls="--", label="constant")
                axis.axhline(untrained, color="tab:red", ls=":", label="untrained")
            axis.set_xticks(range(len(policies)), policies, fontsize=8)
            axis.set(title=network, ylim=(0, 1), ylabel=title if axis is axes[0] else "")
            axis.legend(fontsize=7, loc="lower right")
    save(figure, file)


def draw_curves(study: Study, file: Path) -> None:
    """Draws delta1 against frames, averaged over homes and seeds, with one line per policy, one column per network and
    one row per metric."""
    networks = study.networks()
    figure = Figure((4.6 * len(networks), 6.4), layout="constrained")
    grid = figure.subplots(2, len(networks), squeeze=False, sharex=True)
    for axes, (metric, title) in zip(grid, METRIC_TITLES.items(), strict=True):
        for axis, network in zip(axes, networks, strict=True):
            for policy in study.policies():
                runs = [run for run in study.main_runs() if (run.network, run.policy) == (network, policy)]
                if runs:
                    frames = [point.frames for point in runs[0].curve]
                    lines = [[run.value(metric=metric, point=index) for index in range(len(frames))] for run in runs]
                    axis.plot(
                        frames,
                        np.mean(lines, axis=0),
                        "o-",
                        markersize=3,
                        color=POLICY_COLORS[policy],
                        label=f"{policy} ({len(runs)})",
                    )
            axis.set(title=network, xlabel="frames of the robot", ylabel=title if axis is axes[0] else "")
            axis.grid(alpha=0.3)
            axis.legend(fontsize=7)
    save(figure, file)
