"""Mean paired differences with confidence intervals, where seeds are nested in scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

RESAMPLES = 10_000
# With fewer scenes, equal signs are no surprise (4 of 4: 1 in 8), and the interval is far too narrow.
MIN_SCENES = 5


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % confidence interval."""

    mean: float
    low: float | None
    """`None` for a single scene, which says nothing about others."""
    high: float | None
    scenes: int
    above: int
    """Number of scenes whose mean is above 0, because with a few scenes the interval is narrower than it should be."""
    pairs: int

    @property
    def verdict(self) -> str:
        """Whether the mean is above 0."""
        if self.low is None or self.high is None or self.scenes < MIN_SCENES:
            return f"undecided: {self.scenes} home" + "s" * (self.scenes > 1)
        if self.low > 0:
            return "holds"
        return "fails" if self.high < 0 else "undecided"


def hierarchical_bootstrap(values: Mapping[str, Sequence[float]], seed: int = 0) -> Estimate:
    """The mean over scenes of the mean over seeds of `values`, which are grouped by scene. The bootstrap resamples
    scenes first and then the seeds in each, because seeds of one scene are more alike than scenes."""
    groups = [np.asarray(seeds, np.float64) for _, seeds in sorted(values.items())]
    mean = float(np.mean([group.mean() for group in groups]))
    above = sum(bool(group.mean() > 0) for group in groups)
    pairs = sum(map(len, groups))
    if len(groups) < 2:
        return Estimate(mean, None, None, len(groups), above, pairs)
    random = np.random.default_rng(seed)
    count = len(groups)
    scenes = random.integers(count, size=(RESAMPLES, count))
    # For every scene at every position of every resample: the mean of resampled seeds.
    means_of = np.stack([random.choice(group, (RESAMPLES, count, len(group))).mean(2) for group in groups])
    means = means_of[scenes, np.arange(RESAMPLES)[:, None], np.arange(count)].mean(1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Estimate(mean, float(low), float(high), len(groups), above, pairs)
