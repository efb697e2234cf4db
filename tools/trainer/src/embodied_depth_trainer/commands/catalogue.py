"""`embodied-depth catalogue`: answers questions about the segments of a store."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE, COLUMNS, query
from embodied_depth_trainer.store.store import Store


def add_catalogue(command: argparse.ArgumentParser) -> None:
    command.add_argument("action", choices=("query",), help="query: answer a question in SQL")
    command.add_argument(
        "sql",
        help=f"query over the table `segments` with the columns {', '.join(COLUMNS)}",
    )
    command.add_argument(
        "--store", type=Path, required=True, help=f"output of `prepare`; {CATALOGUE_FILE} is kept in it"
    )


def run_catalogue(options: argparse.Namespace) -> None:
    answer = query(Store(options.store), options.sql)
    print("\t".join(answer.columns))
    for row in answer.rows:
        print("\t".join("" if value is None else str(value) for value in row))
