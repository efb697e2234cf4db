"""Means of paired differences with their uncertainty, where seeds are nested in scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

RESAMPLES = 10_000
# Of fewer scenes, all on one side are no surprise (4 of 4: 1 in 8), and their interval is far too narrow.
LEAST_SCENES = 5


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % interval."""

    mean: float
    low: float | None
    """`None` where a single scene says nothing about others."""
    high: float | None
    scenes: int
    above: int
    """Scenes whose own mean is above 0: with a few scenes, the interval is narrower than it should be."""
    pairs: int

    @property
    def verdict(self) -> str:
        """Whether the mean is above 0."""
        if self.low is None or self.high is None or self.scenes < LEAST_SCENES:
            return f"undecided: {self.scenes} home" + "s" * (self.scenes > 1)
        if self.low > 0:
            return "holds"
        return "fails" if self.high < 0 else "undecided"


def hierarchical_bootstrap(values: Mapping[str, Sequence[float]], seed: int = 0) -> Estimate:
    """Of `values` by scene: the mean over scenes of the mean over seeds. Scenes are resampled first, then the seeds in
    each: seeds of one scene are more alike than scenes are."""
    groups = [np.asarray(seeds, np.float64) for _, seeds in sorted(values.items())]
    mean = float(np.mean([group.mean() for group in groups]))
    above, pairs = sum(bool(group.mean() > 0) for group in groups), sum(map(len, groups))
    if len(groups) < 2:
        return Estimate(mean, None, None, len(groups), above, pairs)
    random = np.random.default_rng(seed)
    count = len(groups)
    scenes = random.integers(count, size=(RESAMPLES, count))
    # Of each scene in every place of every resample: the mean of resampled seeds.
    means_of = np.stack([random.choice(group, (RESAMPLES, count, len(group))).mean(2) for group in groups])
    means = means_of[scenes, np.arange(RESAMPLES)[:, None], np.arange(count)].mean(1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Estimate(mean, float(low), float(high), len(groups), above, pairs)
