"""What `embodied-depth train`, `evaluate` and `export` do."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import torch
from torch import nn
from tqdm import tqdm

from . import calibration, experiment, processes
from . import checkpoint as checkpoints
from .board import Board
from .buffer import kept
from .checkpoint import write_atomically
from .coarse import read_dataset_dump, with_coarse
from .depth_networks import build_network
from .errors import TrainerError
from .evaluation import evaluate, table
from .frames import Frames, join
from .held_out import without_held_out
from .labels import with_labels, write_labels
from .losses import LossOptions
from .objectives import recipe
from .pairs import PairRule, Pairs, pairs_by_baseline, pairs_by_gap
from .past_frames import PastFrames, with_past_coarse
from .recording import read_recording
from .training import Settings, Trainer, train
from .views import Views

# What a training was run with, beside its checkpoint.
EXPERIMENT_FILE = "experiment.toml"


def read_frames(
    recordings: Sequence[Path],
    coarse: Sequence[Path],
    datasets: Sequence[Path],
    size: tuple[int, int] | None,
    label_files: Sequence[Path] = (),
    every: int = 1,
    lidar: bool = False,
    past: PastFrames | None = None,
) -> Frames:
    """All runs and dataset dumps as one set, every `every`th picture, reduced to `size` rows x columns; with `lidar`,
    with what the runs' LiDAR hit; with `past`, with coarse depth from past frames and not the robot's own."""
    if past is not None and coarse:
        raise TrainerError("coarse depth comes either from past frames or from --coarse; give one of the two")

    def ready(frames: Frames, every: int) -> Frames:
        if past is None:
            frames = frames.every(every)
            return frames.reduced_to(size) if size else frames
        # Past frames are counted in the whole recording.
        return with_past_coarse(frames.reduced_to(size) if size else frames, past).every(every)

    if coarse and len(coarse) != len(recordings):
        raise TrainerError(
            f"{len(coarse)} --coarse for {len(recordings)} --recording; give one for each, in the same order, or none"
        )
    if label_files and len(label_files) != len(recordings):
        raise TrainerError(
            f"{len(label_files)} --labels for {len(recordings)} --recording; give one for each, in the same order"
        )
    parts = []
    for place, path in enumerate(recordings):
        frames, damage = read_recording(path, lidar)
        if damage.segments:
            print(f"{path}: {damage}", file=sys.stderr)
        if coarse:
            frames = with_coarse(frames, coarse[place])
        if label_files:
            frames = with_labels(frames, label_files[place])
        parts.append(ready(frames, every))
    for folder in datasets:
        parts.append(ready(read_dataset_dump(folder), 1))
    return join(parts)


def find_pairs(frames: Frames, gap: int | None, rule: PairRule) -> Pairs:
    """Pairs to train on: what is held out is in none of them."""
    return without_held_out(frames, pairs_by_baseline(frames, rule) if gap is None else pairs_by_gap(frames, gap))


def loss_options(options: argparse.Namespace) -> LossOptions:
    """The network's recipe, and what was asked for instead."""
    asked = {name: getattr(options, name) for name in ("smoothness", "geometry", "auto_mask")}
    given = {name: value for name, value in asked.items() if value is not None}
    return replace(
        recipe(options.network),
        exposure=not options.no_exposure,
        visibility=options.visibility,
        census=options.census,
        **given,
    )


def run_label(options: argparse.Namespace) -> None:
    frames = read_frames([options.recording], [options.coarse], [], None)
    share = write_labels(frames, options.out)
    print(f"{options.out}: {len(frames)} pictures, labels for {share:.0%} of their cells")


def run_calibrate(options: argparse.Namespace) -> None:
    torch.set_num_threads(1)
    frames = read_frames(options.recording, options.coarse, [], None, options.labels, options.every)
    found, counts = calibration.calibrate(options.model, frames, options.out)
    print(f"{options.out}: by {len(frames)} pictures, {calibration.table(counts, found)}")


def run_train(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    device = processes.start(options.device)
    frames = read_frames(
        options.recording,
        options.coarse,
        options.dataset,
        options.size,
        options.labels,
        options.every,
        lidar=options.lidar_weight > 0,
        past=PastFrames(options.past_frames, options.past_gap) if options.past_frames else None,
    )
    low, high = options.baseline
    pairs = find_pairs(frames, options.gap, PairRule(min_baseline_m=low, max_baseline_m=high))
    print(f"{len(frames)} pictures, {len(pairs)} of them with sources", file=sys.stderr)
    if options.buffer is not None:
        pairs = kept(frames, pairs, options.buffer, options.keep, options.seed)
    near, far = options.depth_range
    settings = Settings(
        network=options.network,
        seed=options.seed,
        batch=options.batch,
        learning_rate=options.learning_rate,
        depth_range_m=(near, far),
        augment=not options.no_augmentation,
        coarse_weight=options.coarse_weight,
        uncertainty_weight=options.uncertainty_weight,
        label_weight=options.label_weight,
        lidar_weight=options.lidar_weight,
        photometric_weight=options.photometric_weight,
        crop_width=options.crop_width,
        decay=(options.decay_from, options.steps) if options.decay_from is not None else None,
        encoder=options.encoder,
        amp=options.amp,
        teacher_steps=options.teacher_steps,
        past_frames=options.past_frames,
        past_gap=options.past_gap,
        loss=loss_options(options),
    )
    trainer = Trainer(frames, pairs, settings, device)
    first = processes.rank() == 0
    if first:
        asked = {name: value for name, value in vars(options).items() if name not in ("command", "experiment")}
        write_atomically(experiment.written(asked).encode(), options.out / EXPERIMENT_FILE)
    board = Board(options.out / "tensorboard", trainer) if options.tensorboard and first else None
    start = time.perf_counter()
    with tqdm(total=options.steps, unit="step", disable=None if first else True) as bar:

        def told(step: int, loss: float) -> None:
            if board:
                board.told(step, loss)
            bar.n = step
            bar.set_postfix(loss=f"{loss:.4f}", refresh=False)
            bar.update(0)
            # Without a terminal, a line every tenth.
            if first and bar.disable and step % max(1, options.steps // 10) == 0:
                print(f"step {step} of {options.steps}, loss {loss:.4f}", file=sys.stderr, flush=True)

        file = train(trainer, options.steps, options.out, options.checkpoint_every, told)
    if board:
        board.close()
    waited = trainer.batches.waited_s / (time.perf_counter() - start)
    print(f"{file}: {trainer.step} steps; {waited:.1%} of the time was spent waiting for data")


def run_evaluate(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    networks: dict[str, nn.Module] = {}
    size, depth_range_m, past = options.size, (0.1, 20.0), None
    if options.checkpoint is not None:
        saved = checkpoints.load(options.checkpoint)
        size = size or (saved.camera.height, saved.camera.width)
        depth_range_m, past = saved.depth_range_m, saved.past_frames
        networks["untrained"] = build_network(saved.network, depth_range_m, int(saved.settings["seed"]))
        networks[f"{saved.network}, {saved.step} steps"] = saved.build()
    networks = {name: network.to(options.device) for name, network in networks.items()}
    if options.views is not None:
        if past is not None:
            raise TrainerError("test views have no past frames to compute coarse depth from; give a --recording")
        parts = Views.read(options.views).metrics(networks, depth_range_m)
    else:
        frames = read_frames(options.recording, options.coarse, options.dataset, size, every=options.every, past=past)
        parts = {"all": evaluate(frames, networks, depth_range_m)}
    print("\n\n".join((f"{part}:\n" if len(parts) > 1 else "") + table(rows) for part, rows in parts.items()))
    if options.json is not None:
        plain = {part: {name: asdict(row) for name, row in rows.items()} for part, rows in parts.items()}
        write_atomically(json.dumps(plain if options.views else plain["all"], indent=2).encode(), options.json)
