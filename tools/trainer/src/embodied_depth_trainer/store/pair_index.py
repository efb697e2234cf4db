"""Pairs of frames to train on, found once for each shard and kept.

The index of a shard holds the pairs within it and those with the frames before it, in both directions. So it depends on
the shard and on the ones before it, and a run that grows changes no index that exists.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.held_out import only_held_out, targets_alone, without_held_out
from embodied_depth_trainer.data.pairs import PairRule, Pairs, by_side, pairs_by_gap, sources_of
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import DamagedError, FolderWriter
from embodied_depth_trainer.store.dataset import Dataset, Part
from embodied_depth_trainer.store.store import Store

# Frames that a validation measures. More of one recording are near others and cost time.
VALIDATION_FRAMES = 32
NAME_DIGITS = 8


def find_pairs(dataset: Dataset, gap: int | None, rule: PairRule, needs_sources: bool = True) -> tuple[Pairs, Pairs]:
    """Pairs for training, without held-out frames, and pairs of held-out frames for validation: by the rule, or `gap`
    frames apart. For a loss that needs no sources, all frames without any."""
    if not needs_sources:
        return targets_alone(dataset.frames, VALIDATION_FRAMES)
    pairs = indexed_pairs(dataset, rule) if gap is None else pairs_by_gap(dataset.frames, gap)
    frames = dataset.frames
    return without_held_out(frames, pairs), only_held_out(frames, pairs, VALIDATION_FRAMES)


def indexed_pairs(dataset: Dataset, rule: PairRule) -> Pairs:
    """All pairs whose baseline and overlap satisfy the rule, from the indices of all parts."""
    ends = np.cumsum([len(part.frames) for part in dataset.parts])
    found = []
    for place, part in enumerate(tqdm(dataset.parts, unit="shard", desc="pairs", disable=None)):
        end = int(ends[place])
        before = _before(dataset.parts, place, rule.max_gap)
        begin = end - len(part.frames)
        reach = begin - sum(len(dataset.parts[other].frames) for other in before)
        found.append(_index(dataset, part, [dataset.parts[other] for other in before], (reach, begin, end), rule))
    targets, sources = np.concatenate(found, axis=1)
    if not len(targets):
        raise TrainerError(
            f"none of {len(dataset.frames)} frames has a source with enough baseline and overlap; "
            "move more, or allow shorter baselines"
        )
    order = np.lexsort((sources, targets))
    different, first = np.unique(targets[order], return_index=True)
    return by_side(different, np.split(sources[order], first[1:]))


def _before(parts: Sequence[Part], place: int, gap: int) -> list[int]:
    """The parts of the same run before one, as many as `gap` frames reach, in their order."""
    found: list[int] = []
    frames = 0
    for other in range(place - 1, -1, -1):
        if parts[place].store is None or parts[other].run != parts[place].run or frames >= gap:
            break
        found.insert(0, other)
        frames += len(parts[other].frames)
    return found


def _index(
    dataset: Dataset, part: Part, before: Sequence[Part], bounds: tuple[int, int, int], rule: PairRule
) -> NDArray[np.int64]:
    """Targets and sources [2, pairs] of one part: those that were kept, or found now."""
    if part.store is None:
        return pairs_within(dataset.frames, *bounds, rule)
    given = [asdict(rule), dataset.every, part.digest, [other.digest for other in before]]
    key = hashlib.sha256(json.dumps(given).encode()).hexdigest()
    name = f"{part.name}-{key[:NAME_DIGITS]}"
    begin = bounds[1]
    kept = _kept(part.store, name)
    if kept is None:
        kept = pairs_within(dataset.frames, *bounds, rule) - begin
        _keep(kept, part.store.pairs(name))
    return kept + begin


def pairs_within(frames: FrameSet, reach: int, begin: int, end: int, rule: PairRule) -> NDArray[np.int64]:
    """Targets and sources [2, pairs] among the frames from `reach` to `end` of which at least one is at `begin` or
    later."""
    found = []
    for target in range(max(reach, begin - rule.max_gap), end):
        sources = sources_of(frames, target, range(reach if target >= begin else begin, end), rule)
        found.append(np.stack([np.full(len(sources), target), sources]))
    return np.concatenate(found, axis=1)


def _kept(store: Store, name: str) -> NDArray[np.int64] | None:
    try:
        kept = store.open_pairs(name)
        kept.check()
        return kept.load("pairs", np.int32).T.astype(np.int64)
    except DamagedError:
        return None


def _keep(pairs: NDArray[np.int64], folder: Path) -> None:
    writer = FolderWriter(folder, pairs.shape[1])
    writer.append("pairs", pairs.T.astype(np.int32))
    writer.finish({})
