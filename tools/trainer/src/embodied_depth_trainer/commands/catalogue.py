"""`embodied-depth catalogue`: answers questions about the segments of a store, and freezes sets of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE, COLUMNS, query
from embodied_depth_trainer.store.listing import freeze
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import write_version


def add_catalogue(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True)
    _add(actions, "query", "answer a question in SQL", _query)
    frozen = _add(actions, "freeze", "write the shards that a query returns as a list to train on", _freeze)
    frozen.add_argument("--out", type=Path, required=True, help="the list, for `train --only`")


def _add(
    actions: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    help_text: str,
    run: Callable[[argparse.Namespace], None],
) -> argparse.ArgumentParser:
    action = actions.add_parser(name, help=help_text, description=help_text)
    action.add_argument("sql", help=f"query over the table `segments` with the columns {', '.join(COLUMNS)}")
    action.add_argument(
        "--store", type=Path, required=True, help=f"output of `prepare`; {CATALOGUE_FILE} is kept in it"
    )
    action.set_defaults(run_action=run)
    return action


def run_catalogue(options: argparse.Namespace) -> None:
    options.run_action(options)


def _query(options: argparse.Namespace) -> None:
    answer = query(Store(options.store), options.sql)
    print("\t".join(answer.columns))
    for row in answer.rows:
        print("\t".join("" if value is None else str(value) for value in row))


def _freeze(options: argparse.Namespace) -> None:
    store = Store(options.store)
    answer = query(store, options.sql)
    if "shard" not in answer.columns:
        raise TrainerError(
            f"`{options.sql}` returns {', '.join(answer.columns)} and not the column `shard`; begin it with SELECT *"
        )
    column = answer.columns.index("shard")
    version = freeze(store, [row[column] for row in answer.rows])
    # What the store remembers as frozen is kept by `prepare --prune`.
    for file in (store.frozen(version.name), options.out):
        write_version(version, file)
    frames = version.summary["frames"]
    print(f"{options.out}: dataset {version.name}, {len(version.shards)} shards with {frames} frames")
