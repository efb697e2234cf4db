"""Options and argument types that several subcommands share."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from embodied_depth_trainer import cluster
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.registry import DEPTH_NETWORKS
from embodied_depth_trainer.store.cache import Cache
from embodied_depth_trainer.store.known_robots import KnownRobots, read_robots
from embodied_depth_trainer.store.remote import RemoteStore
from embodied_depth_trainer.store.sources import is_url
from embodied_depth_trainer.store.store import Store

CACHE_BYTES = 20_000_000_000
POLICIES = ("random", "heuristic", "forward", "frontier", "inconsistency", "active")


def image_size(text: str) -> tuple[int, int]:
    """Parses `192x640`: rows x columns, as the papers write it."""
    try:
        height, width = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not a size such as 192x640 (rows x columns)") from None
    if min(height, width) <= 0:
        raise argparse.ArgumentTypeError(f"`{text}` is empty; rows and columns must be above 0")
    return height, width


def source(text: str) -> Path | str:
    """A directory or a URL."""
    return text if is_url(text) else Path(text)


def byte_count(text: str) -> int:
    """Parses `20G`: 20 * 10^9."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([kMGT]?)", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"`{text}` is not a number of bytes such as 500M, 20G or 1.5T")
    return int(float(found[1]) * 1000 ** " kMGT".index(found[2] or " "))


def add_stores(command: argparse.ArgumentParser) -> None:
    """The stores that `train` and `calibrate` read."""
    command.add_argument(
        "--store",
        type=source,
        action="append",
        default=[],
        metavar="FOLDER|URL",
        help="output of `prepare`, or the URL of a copy of it in an object store (s3://BUCKET/PREFIX, "
        "gs://BUCKET/PREFIX, file:///FOLDER), which is read through --cache; may be repeated",
    )
    command.add_argument(
        "--cache",
        type=Path,
        metavar="FOLDER",
        help="where files of a --store in an object store are kept; trainings on one computer may share it",
    )
    command.add_argument(
        "--cache-bytes",
        type=byte_count,
        default=CACHE_BYTES,
        metavar="BYTES",
        help="most that these files may have in all; those that were not used for longest are deleted [20G]",
    )
    command.add_argument("--every", type=int, default=1, help="use every Nth frame of each segment [1]")


def opened_stores(options: argparse.Namespace) -> list[Store]:
    """The stores of `add_stores`."""
    urls = [store for store in options.store if is_url(store)]
    if urls and options.cache is None:
        raise TrainerError(
            f"{urls[0]} is read through a cache on the disk; give its folder, --cache FOLDER, and --cache-bytes if it "
            "may have more or less than 20 GB"
        )
    if not urls:
        return [Store(folder) for folder in options.store]
    cache = Cache(options.cache, options.cache_bytes)
    return [RemoteStore(store, cache) if is_url(store) else Store(store) for store in options.store]


def add_dumps(command: argparse.ArgumentParser) -> None:
    """Datasets for `train` and `evaluate`."""
    command.add_argument(
        "--dataset", type=Path, action="append", default=[], help="output of `firmware-host perceive --dataset --dump`"
    )


def add_cluster(command: argparse.ArgumentParser, what: str) -> None:
    command.add_argument(
        "--on",
        type=cluster.place,
        default=cluster.LOCAL,
        metavar="local|ray|ray://HEAD:PORT",
        help=f"where {what} run: on this computer, or on the Ray cluster that RAY_ADDRESS or a running `ray start` "
        "names (without one, a new one on this computer); its nodes must see all directories of this command under the "
        "same paths [local]",
    )


def with_absolute_paths(options: argparse.Namespace) -> argparse.Namespace:
    """The same options for processes in other working directories."""
    return argparse.Namespace(**{name: _absolute(value) for name, value in vars(options).items()})


def _absolute(value: object) -> object:
    if isinstance(value, list):
        return [_absolute(item) for item in value]
    return value.absolute() if isinstance(value, Path) else value


def add_threads(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--threads", type=int, default=1, help="CPU threads; more only help on an otherwise idle computer [1]"
    )


def add_device(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="auto: the GPU if there is one [auto]"
    )


def add_amp(command: argparse.ArgumentParser) -> None:
    command.add_argument("--amp", action="store_true", help="compute in bfloat16, for CPUs with AMX and for GPUs")


def add_init(command: argparse.ArgumentParser, default: str = "none") -> None:
    command.add_argument(
        "--init",
        metavar="FILE",
        help="weights to go on from: a checkpoint.pt, an exported .onnx file, `shipped` for the robot's default "
        f"network, or `none` for random ones [{default}]",
    )


def add_study_options(
    command: argparse.ArgumentParser,
    size: tuple[int, int],
    step_scale: float,
    batch: int,
    learning_rate: float,
    views: int,
    views_seed: int,
) -> None:
    """The options that `loop` and `fleet` share, with their default values."""
    command.add_argument("--seed", type=int, default=1, help="seed of everything random [1]")
    command.add_argument("--size", type=image_size, default=size, help="rows x columns of the images [96x320]")
    command.add_argument(
        "--step-scale", type=float, default=step_scale, help="multiplies the steps of 3 cm and 2 degrees [1]"
    )
    command.add_argument(
        "--gap", type=int, help="train on pairs this many frames apart, 4 in the paper [pairs are chosen by baseline]"
    )
    command.add_argument("--batch", type=int, default=batch, help="samples per training step [12]")
    command.add_argument("--learning-rate", type=float, default=learning_rate, help="learning rate of Adam [1e-4]")
    command.add_argument("--views", type=int, default=views, help="number of test views of each scene [200]")
    command.add_argument("--views-seed", type=int, default=views_seed, help="seed of the test views [1000]")
    add_firmware_host(command)
    add_init(command)
    add_device(command)
    add_amp(command)
    command.add_argument("--threads", type=int, default=1, help="CPU threads [1]")


def add_firmware_host(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--firmware-host", type=Path, metavar="FILE", help="the robot's program [search the PATH, then target/release]"
    )


def add_robots(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--robots",
        type=Path,
        metavar="FILE",
        help="train only on segments that one of these robots signed: a public key in each line [signatures are not "
        "checked]",
    )


def known_robots(options: argparse.Namespace) -> KnownRobots | None:
    return None if options.robots is None else read_robots(options.robots)


def add_network(command: argparse.ArgumentParser) -> None:
    command.add_argument("--network", choices=DEPTH_NETWORKS, default="student", help="architecture [student]")
