"""Reads recordings and dataset dumps into memory, as studies and evaluations need them, and finds pairs in them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from embodied_depth_trainer.data.coarse_depth import read_dataset_dump, with_coarse
from embodied_depth_trainer.data.frames import Frames, join
from embodied_depth_trainer.data.held_out import only_held_out, targets_alone, without_held_out
from embodied_depth_trainer.data.pairs import PairRule, Pairs, pairs_by_baseline, pairs_by_gap
from embodied_depth_trainer.data.past_frames import PastFrames, with_past_coarse
from embodied_depth_trainer.data.recording import read_recording
from embodied_depth_trainer.errors import TrainerError


def read_frames(
    recordings: Sequence[Path],
    coarse: Sequence[Path],
    datasets: Sequence[Path],
    size: tuple[int, int] | None,
    every: int = 1,
    past: PastFrames | None = None,
) -> Frames:
    """Reads runs with their dumped coarse depth, and dataset dumps, as one set: every `every`th frame, reduced to
    `size` rows x columns, with `past` with coarse depth from past frames instead of the robot's own."""
    if past is not None and coarse:
        raise TrainerError("coarse depth comes either from past frames or from --coarse; give one of the two")

    def ready(frames: Frames, every: int) -> Frames:
        if past is None:
            frames = frames.every(every)
            return frames.reduced_to(size) if size else frames
        # Past frames are counted in the full recording, so the selection comes afterwards.
        return with_past_coarse(frames.reduced_to(size) if size else frames, past).every(every)

    if coarse and len(coarse) != len(recordings):
        raise TrainerError(
            f"{len(coarse)} --coarse for {len(recordings)} --recording; give one for each, in the same order, or none"
        )
    parts = []
    for place, path in enumerate(recordings):
        frames, damage = read_recording(path)
        if damage.segments:
            print(f"{path}: {damage}", file=sys.stderr)
        if coarse:
            frames = with_coarse(frames, coarse[place])
        parts.append(ready(frames, every))
    for folder in datasets:
        parts.append(ready(read_dataset_dump(folder), 1))
    return join(parts)


# Frames that a validation measures. More of one recording are near others and cost time.
VALIDATION_FRAMES = 32


def find_pairs(frames: Frames, gap: int | None, rule: PairRule, needs_sources: bool = True) -> tuple[Pairs, Pairs]:
    """Pairs for training, without held-out frames, and pairs of held-out frames for validation: by the rule, or `gap`
    frames apart. For a loss that needs no sources, all frames without any."""
    if not needs_sources:
        return targets_alone(frames, VALIDATION_FRAMES)
    pairs = pairs_by_baseline(frames, rule) if gap is None else pairs_by_gap(frames, gap)
    return without_held_out(frames, pairs), only_held_out(frames, pairs, VALIDATION_FRAMES)
