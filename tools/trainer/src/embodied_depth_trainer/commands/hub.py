"""`embodied-depth hub`: uploads networks and datasets to a model hub, and downloads them."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from embodied_depth_trainer.commands.card import add_described, card_of, dataset_of, is_network
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.sharing.dataset_card import Contents
from embodied_depth_trainer.sharing.downloads import CARD_FILE, DATASET_PATTERNS, download_dataset, download_model
from embodied_depth_trainer.sharing.examination import examine
from embodied_depth_trainer.sharing.hub import Kind, Repository, snapshot, upload
from embodied_depth_trainer.sharing.publish import stage


def add_hub(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True)

    def action(name: str, text: str, run: Callable[[argparse.Namespace], None]) -> argparse.ArgumentParser:
        added = actions.add_parser(name, help=text, description=text)
        added.set_defaults(run_action=run)
        added.add_argument("repository", metavar="OWNER/NAME")
        return added

    sent = action("upload", "upload a network or a dataset with its card; the repository is made if it is new", _upload)
    add_described(sent)
    sent.add_argument("--card", type=Path, metavar="FILE", help="a card that you have edited [as `card` writes it]")
    sent.add_argument("--public", action="store_true", help="everyone may see the repository [it is private]")
    brought = action("download", "download and check a network or a dataset", _download)
    brought.add_argument("--type", choices=("model", "dataset"), default="model", help="kind of the repository [model]")
    brought.add_argument("--revision", default="main", metavar="REV", help="branch, tag or commit [main]")
    brought.add_argument("--file", metavar="NAME", help="the network, if the repository has several")
    brought.add_argument(
        "--expect", metavar="DIGEST", help="refuse anything but the network with this SHA-256, or this dataset version"
    )
    brought.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="directory for the network, or for a new store"
    )


def run_hub(options: argparse.Namespace) -> None:
    options.run_action(options)


def _upload(options: argparse.Namespace) -> None:
    card = card_of(options) if options.card is None else _text(options.card)
    kind: Kind = "model" if is_network(options.path) else "dataset"
    repository = Repository(options.repository, kind)
    with tempfile.TemporaryDirectory(prefix="embodied-depth-hub-") as name:
        folder = Path(name)
        if kind == "model":
            # What a download would refuse is not uploaded.
            examine(options.path)
            shutil.copyfile(options.path, folder / options.path.name)
            write_atomically(card.encode(), folder / CARD_FILE)
            done = upload(repository, folder, options.public)
        else:
            version, stores = dataset_of(options)
            if options.public and Contents(version, stores).may_show_homes:
                print(f"warning: {repository} is public, and images may show a real home", file=sys.stderr)
            stage(version, stores, card, folder)
            done = upload(repository, folder, options.public, DATASET_PATTERNS)
    print(f"{repository}: commit {done.commit}, {'private' if done.is_private else 'public'}")


def _text(file: Path) -> str:
    try:
        return file.read_text()
    except (OSError, ValueError) as problem:
        raise TrainerError(f"cannot read the card {file}: {problem}; write one with `embodied-depth card`") from None


def _download(options: argparse.Namespace) -> None:
    found = snapshot(Repository(options.repository, options.type), options.revision)
    print(f"{found.repository}: commit {found.commit}")
    if options.type == "dataset":
        version = download_dataset(found, options.expect, options.out)
        print(f"{options.out}: dataset {version.name}, all digests are right; train on it with --store {options.out}")
        return
    file, digest = download_model(found, options.file, options.expect, options.out)
    print(f"{file}: sha256 {digest}, the golden pair is right")
    print(f"no robot trusts it yet: `push-model --key KEY {file} ROBOT` signs it, and the robot's gate examines it")
