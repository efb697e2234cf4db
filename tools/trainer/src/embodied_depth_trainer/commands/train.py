"""`embodied-depth train`: trains a depth network on recordings."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from embodied_depth_trainer import processes
from embodied_depth_trainer.cluster import LOCAL
from embodied_depth_trainer.commands import experiment
from embodied_depth_trainer.commands.arguments import (
    add_amp,
    add_cluster,
    add_device,
    add_dumps,
    add_init,
    add_network,
    add_stores,
    add_threads,
    image_size,
    opened_stores,
    with_absolute_paths,
)
from embodied_depth_trainer.data.buffer import select
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.data.past_frames import GAP, PastFrames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.losses.recipes import recipe
from embodied_depth_trainer.losses.reprojection import LossOptions
from embodied_depth_trainer.store.bucket import patience
from embodied_depth_trainer.store.dataset import open_dataset, record_version
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.remote import RemoteStore
from embodied_depth_trainer.store.store import Store, past_of
from embodied_depth_trainer.store.version import DATASET_FILE, read_version
from embodied_depth_trainer.training.initial import chosen, given_depth
from embodied_depth_trainer.training.progress import Progress, draw
from embodied_depth_trainer.training.ray_ranks import Ranks, run_ranks
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.tensorboard import Board
from embodied_depth_trainer.training.trainer import Trainer, train

# The options of a training, written beside its checkpoint.
EXPERIMENT_FILE = "experiment.toml"
# Options that select the command, a file of options or the computers, and so do not belong into that file.
NOT_RECORDED = ("command", "run_command", "experiment", "on", "ranks")


def add_train(command: argparse.ArgumentParser) -> None:
    add_stores(command)
    add_dumps(command)
    command.add_argument(
        "--only",
        type=Path,
        metavar="FILE",
        help="train on exactly the shards that this file lists, in the order of the file: output of `catalogue "
        f"freeze`, or the {DATASET_FILE} of a training [all shards of the stores]",
    )
    command.add_argument("--size", type=image_size, help="reduce the images of --dataset to rows x columns")
    add_device(command)
    add_threads(command)
    add_cluster(command, "the processes of --ranks")
    command.add_argument(
        "--ranks",
        type=int,
        metavar="N",
        help="on a Ray cluster: number of processes that divide every batch, each with --threads CPUs and, as --device "
        "says, one GPU [1]",
    )
    command.add_argument(
        "--readers", type=int, default=1, help="threads that prepare batches ahead; each prepares one [1]"
    )
    add_network(command)
    command.add_argument(
        "--steps", type=int, required=True, help="total number of steps; a training in --out continues from where it is"
    )
    command.add_argument("--out", type=Path, required=True, help="directory of the checkpoint and its experiment.toml")
    command.add_argument(
        "--given-depth",
        choices=("coarse", "dense"),
        help="what the network is given besides the image: the robot's coarse depth, or its dense depth [what the "
        "network of --init is given, else coarse]",
    )
    command.add_argument("--seed", type=int, default=0, help="seed of weights, sampling and augmentation [0]")
    command.add_argument("--batch", type=int, default=12, help="samples per step [12]")
    command.add_argument("--learning-rate", type=float, default=1e-4, help="learning rate of Adam [1e-4]")
    command.add_argument(
        "--encoder",
        metavar="FILE",
        help="initial weights of the image encoder (ResNet18): torchvision's state dict, or `imagenet` to download it "
        "[random]",
    )
    add_init(command)
    add_amp(command)
    command.add_argument(
        "--validate-every",
        type=int,
        metavar="STEPS",
        help="steps between two validations on the recording's held-out places [a tenth of --steps]",
    )
    command.add_argument(
        "--experiment", type=Path, help="TOML file with these options; options on the command line override it"
    )
    command.add_argument("--tensorboard", action="store_true", help="write OUT/tensorboard")
    command.add_argument("--buffer", type=int, metavar="FRAMES", help="train on at most this many target frames [all]")
    command.add_argument(
        "--keep",
        choices=("newest", "poses"),
        default="newest",
        help="which frames --buffer keeps: the newest, or equally many of every pose bin [newest]",
    )
    command.add_argument(
        "--checkpoint-every", type=int, default=200, metavar="STEPS", help="steps between two checkpoints [200]"
    )
    command.add_argument(
        "--baseline",
        type=float,
        nargs=2,
        default=(0.05, 0.30),
        metavar=("MIN_M", "MAX_M"),
        help="baseline of the pairs [0.05 0.30]",
    )
    command.add_argument(
        "--gap", type=int, help="use pairs this many frames apart instead, 4 or 15 in the paper [pairs by baseline]"
    )
    command.add_argument("--depth-range", type=float, nargs=2, default=(0.1, 20.0), metavar=("MIN_M", "MAX_M"))
    command.add_argument("--smoothness", type=float, help="weight of the smoothness loss [1e-3; sc_depth_r18: 0.1]")
    command.add_argument("--geometry", type=float, help="weight of the geometry consistency [0; sc_depth_r18: 0.5]")
    command.add_argument(
        "--coarse-weight",
        type=float,
        default=0.1,
        help="weight of the agreement with the depth that the network is given [0.1]",
    )
    command.add_argument(
        "--color-change",
        type=float,
        metavar="SHARE",
        help="change colours of most images by up to this share; the default network was trained with 0.5 [of half of "
        "them, by up to 0.2, as in the paper's code]",
    )
    command.add_argument(
        "--label-weight", type=float, default=1.0, help="weight of the agreement with the store's labels [1]"
    )
    command.add_argument(
        "--lidar-weight",
        type=float,
        default=0.0,
        help="weight of the agreement with the LiDAR's line of depths [0: no depth sensor is used]",
    )
    command.add_argument("--photometric-weight", type=float, default=1.0, help="weight of the photometric loss [1]")
    command.add_argument(
        "--crop-width", type=int, default=0, help="columns of each target image that a step uses, at random [0: all]"
    )
    command.add_argument(
        "--decay-from", type=int, metavar="STEP", help="step at which the learning rate begins to fall to 0 at --steps"
    )
    command.add_argument(
        "--uncertainty-weight", type=float, default=0.05, help="weight of the loss of the predicted error scale [0.05]"
    )
    command.add_argument(
        "--auto-mask",
        action=argparse.BooleanOptionalAction,
        help="ignore pixels that match better without warping, as the paper's code does [only sc_depth_r18]",
    )
    command.add_argument("--visibility", action="store_true", help="ignore points that are occluded in the source")
    command.add_argument("--census", action="store_true", help="compare census transforms instead of colours")
    command.add_argument(
        "--teacher-steps", type=int, default=2000, help="manydepth_r18: steps for which its teacher learns [2000]"
    )
    command.add_argument("--no-exposure", action="store_true", help="do not fit gain and bias of each pair")
    command.add_argument("--no-augmentation", action="store_true", help="neither jitter colours nor drop coarse depth")


def loss_options(options: argparse.Namespace) -> LossOptions:
    """The loss that the network's authors use, with the options that were given on top."""
    optional = {name: getattr(options, name) for name in ("smoothness", "geometry", "auto_mask")}
    given = {name: value for name, value in optional.items() if value is not None}
    return replace(
        recipe(options.network),
        exposure=not options.no_exposure,
        visibility=options.visibility,
        census=options.census,
        **given,
    )


def settings_of(options: argparse.Namespace, past: PastFrames | None) -> Settings:
    near, far = options.depth_range
    return Settings(
        network=options.network,
        seed=options.seed,
        batch=options.batch,
        learning_rate=options.learning_rate,
        depth_range_m=(near, far),
        augment=not options.no_augmentation,
        color_change=options.color_change,
        coarse_weight=options.coarse_weight,
        uncertainty_weight=options.uncertainty_weight,
        label_weight=options.label_weight,
        lidar_weight=options.lidar_weight,
        photometric_weight=options.photometric_weight,
        crop_width=options.crop_width,
        decay=(options.decay_from, options.steps) if options.decay_from is not None else None,
        encoder=options.encoder,
        init=chosen(options.init),
        amp=options.amp,
        given_depth=options.given_depth or given_depth(chosen(options.init)),
        teacher_steps=options.teacher_steps,
        past_frames=past.count if past is not None else 0,
        past_gap=past.gap if past is not None else GAP,
        loss=loss_options(options),
    )


def run_train(options: argparse.Namespace) -> None:
    if options.on == LOCAL:
        if options.ranks is not None:
            raise TrainerError("--ranks needs --on ray; on one computer, torchrun starts several processes")
        run_rank(options, options.device)
        return
    run_ranks(run_rank, for_other_computers(options), ranks_of(options))


def for_other_computers(options: argparse.Namespace) -> argparse.Namespace:
    """The options without what cannot be sent, and with absolute paths."""
    sent = with_absolute_paths(options)
    del sent.run_command
    for name in ("init", "encoder"):
        file = getattr(sent, name)
        # Other values stand for weights that the package has or downloads.
        if file is not None and Path(file).is_file():
            setattr(sent, name, str(Path(file).absolute()))
    return sent


def ranks_of(options: argparse.Namespace) -> Ranks:
    count = 1 if options.ranks is None else options.ranks
    return Ranks(count, options.on, options.threads, options.device, options.out.absolute())


def warn_of_repeated_downloads(stores: Sequence[Store]) -> None:
    """Says so if the cache cannot hold what a training reads."""
    remote = [store for store in stores if isinstance(store, RemoteStore)]
    size = sum(store.bytes for store in remote)
    if remote and size > remote[0].cache.limit and processes.rank() == 0:
        limit = remote[0].cache.limit
        print(
            f"the cache holds {limit / size:.0%} of the shards ({limit:,} of {size:,} bytes). Batches are drawn from "
            f"all shards at random, so up to {1 - limit / size:.0%} of the files that a batch reads are downloaded "
            f"again, as a whole. That is slow; --cache-bytes {size} holds all of them",
            file=sys.stderr,
        )


@patience()
def run_rank(options: argparse.Namespace, device: str) -> None:
    """Trains in this process, alone or together with the others that `processes.start` finds."""
    torch.set_num_threads(options.threads)
    device = processes.start(device)
    stores = opened_stores(options)
    only = read_version(options.only) if options.only is not None else None
    dataset = open_dataset(stores, options.dataset, options.size, options.every, only=only)
    if not processes.is_same_in_all(dataset.version.name, device):
        raise TrainerError(
            f"the processes of this training read different datasets, this one {dataset.version.name}: the store was "
            "changed while they opened it, or an object is damaged for one of them; start the training again"
        )
    warn_of_repeated_downloads(stores)
    frames = dataset.frames
    if options.lidar_weight > 0 and not dataset.has_lidar:
        raise TrainerError(
            f"no frame of {len(frames)} has a LiDAR scan from about its time; train on them without --lidar-weight"
        )
    low, high = options.baseline
    settings = settings_of(options, past_of(stores))
    rule = PairRule(min_baseline_m=low, max_baseline_m=high)
    pairs, validation = find_pairs(dataset, options.gap, rule, settings.needs_sources)
    what = "have source frames" if settings.needs_sources else "are trained on, without source frames"
    print(
        f"{len(frames)} frames, {len(pairs)} of them {what}; validation on {len(validation)} held-out ones",
        file=sys.stderr,
    )
    if options.buffer is not None:
        pairs = select(frames, pairs, options.buffer, options.keep, options.seed)
    trainer = Trainer(frames, pairs, settings, device, options.readers, dataset.summary)
    first = processes.rank() == 0
    if first:
        recorded = {name: value for name, value in vars(options).items() if name not in NOT_RECORDED}
        write_atomically(experiment.to_toml(recorded).encode(), options.out / EXPERIMENT_FILE)
        record_version(dataset, options.out)
    board = Board(options.out / "tensorboard", trainer) if options.tensorboard and first else None
    start = time.perf_counter()
    with Progress(trainer, validation, options.steps, options.out, options.validate_every, board) as progress:
        file = train(trainer, options.steps, options.out, options.checkpoint_every, progress)
    waited = trainer.batches.waited_s / (time.perf_counter() - start)
    if first and progress.rows:
        draw(options.out)
    print(f"{file}: {trainer.step} steps; {waited:.1%} of the time was spent waiting for data")
