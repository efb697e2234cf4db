"""Whether the signed segments of a run follow one another: each signature names the digest of the segment before."""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

from embodied_depth_trainer.store.manifest import Run


def breaks(run: Run, new: Collection[str]) -> list[str]:
    """What to say of signed segments that do not follow the one before, if one of the two is among the new files."""
    signed = [entry for entry in run.in_order if entry.signed_by is not None]
    return [
        f"{run.source}/{after.file} does not follow {before.file}, the signed segment before it: segments are missing "
        "or of another run"
        for before, after in pairwise(signed)
        if after.previous != before.signed_digest and not {before.file, after.file}.isdisjoint(new)
    ]
