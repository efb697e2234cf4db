"""`embodied-depth card`: the card of a network or of a dataset, in the form that model hubs show."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.sharing.cards import CardOptions
from embodied_depth_trainer.sharing.dataset_card import Contents, dataset_card
from embodied_depth_trainer.store.listing import freeze, segments_of
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import DatasetVersion, read_version


def add_card(command: argparse.ArgumentParser) -> None:
    add_described(command)
    command.add_argument(
        "--out", type=Path, metavar="FILE", help="file to write, for a hub README.md [standard output]"
    )


def add_described(command: argparse.ArgumentParser) -> None:
    """What a card is of, and what only the user knows; `hub upload` has the same options."""
    command.add_argument(
        "path",
        type=Path,
        metavar="PATH",
        help="an ONNX file of `export`, a store of `prepare`, or a list of shards of `catalogue freeze` or `train`",
    )
    command.add_argument(
        "--store", type=Path, action="append", default=[], help="the store of a list of shards; may be repeated"
    )
    command.add_argument(
        "--license", metavar="ID", help="licence, for example mit or cc-by-4.0 [none, as the card says]"
    )
    command.add_argument(
        "--results", type=Path, metavar="FILE", help="numbers of a network that `evaluate --json FILE` wrote"
    )
    command.add_argument(
        "--measured-on", metavar="TEXT", help="what the numbers of --results were measured on, in words"
    )
    command.add_argument(
        "--base-model", metavar="OWNER/NAME", help="repository of the network that a training began with"
    )
    command.add_argument(
        "--trained-on",
        action="append",
        default=[],
        metavar="OWNER/NAME",
        help="repository of a dataset that a network was trained on; may be repeated",
    )


def run_card(options: argparse.Namespace) -> None:
    card = card_of(options)
    if options.out is None:
        print(card, end="")
        return
    if options.out.exists():
        # A person may have written into it.
        raise TrainerError(f"{options.out} exists and is not replaced; move it away or give another --out")
    write_atomically(card.encode(), options.out)
    print(options.out)


def card_of(options: argparse.Namespace) -> str:
    """The card of what the user named."""
    words = CardOptions(
        options.license, options.base_model, tuple(options.trained_on), options.results, options.measured_on
    )
    if is_network(options.path):
        # Needs PyTorch.
        from embodied_depth_trainer.sharing.model_card import model_card

        return model_card(options.path, words)
    if options.results or options.measured_on or options.base_model or options.trained_on:
        raise TrainerError(
            f"{options.path} is a dataset; --results, --measured-on, --base-model and --trained-on are for networks"
        )
    return dataset_card(Contents(*dataset_of(options)), words)


def is_network(path: Path) -> bool:
    return path.suffix == ".onnx"


def dataset_of(options: argparse.Namespace) -> tuple[DatasetVersion, list[Store]]:
    """The version of a dataset, and its stores: all of a store, or a list of its shards."""
    if options.path.is_dir():
        store = Store(options.path)
        return freeze(store, [segment.shard for segment in segments_of(store)]), [store]
    version = read_version(options.path)
    if not options.store:
        raise TrainerError(f"{options.path} is a list of shards; give the store that has them with --store")
    return version, [Store(folder) for folder in options.store]
