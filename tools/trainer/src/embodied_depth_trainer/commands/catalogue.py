"""`embodied-depth catalogue`: answers questions about the segments of a store, freezes sets of them, and draws them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE, COLUMNS, query
from embodied_depth_trainer.store.listing import freeze
from embodied_depth_trainer.store.picture import draw
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import write_version

Action = Callable[[argparse.Namespace], None]
Actions: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_catalogue(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True)
    _with_query(actions, "query", "answer a question in SQL", _query)
    drawn = _action(actions, "picture", "draw frames over time, and every run by segment", _picture)
    drawn.add_argument("--out", type=Path, required=True, help="PNG file to write")
    frozen = _with_query(actions, "freeze", "write the shards that a query returns as a list to train on", _freeze)
    frozen.add_argument("--out", type=Path, required=True, help="the list, for `train --only`")


def _action(actions: Actions, name: str, help_text: str, run: Action) -> argparse.ArgumentParser:
    action = actions.add_parser(name, help=help_text, description=help_text)
    action.add_argument(
        "--store", type=Path, required=True, help=f"output of `prepare`; {CATALOGUE_FILE} is kept in it"
    )
    action.set_defaults(run_action=run)
    return action


def _with_query(actions: Actions, name: str, help_text: str, run: Action) -> argparse.ArgumentParser:
    """An action with a query."""
    action = _action(actions, name, help_text, run)
    action.add_argument("sql", help=f"query over the table `segments` with the columns {', '.join(COLUMNS)}")
    return action


def run_catalogue(options: argparse.Namespace) -> None:
    options.run_action(options)


def _query(options: argparse.Namespace) -> None:
    answer = query(options.store, options.sql)
    print("\t".join(answer.columns))
    for row in answer.rows:
        print("\t".join("" if value is None else str(value) for value in row))


def _freeze(options: argparse.Namespace) -> None:
    store = Store(options.store)
    answer = query(store.folder, options.sql)
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


def _picture(options: argparse.Namespace) -> None:
    draw(Store(options.store), options.out)
    print(options.out)
