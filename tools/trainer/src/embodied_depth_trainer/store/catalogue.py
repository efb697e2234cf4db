"""One table of all segments of a store: `catalogue.parquet`, which DuckDB, Polars and pandas read.

DuckDB writes it and answers queries: one package without further ones, and SQL is known.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder
from embodied_depth_trainer.store.manifest import Entry, Run
from embodied_depth_trainer.store.store import Store

CATALOGUE_FILE = "catalogue.parquet"
# Columns and their types in SQL.
COLUMNS = {
    "folder": "VARCHAR",
    "segment": "VARCHAR",
    "robot": "VARCHAR",
    "name": "VARCHAR",
    "site": "VARCHAR",
    "run": "VARCHAR",
    "began": "TIMESTAMP",
    "scene": "VARCHAR",
    "policy": "VARCHAR",
    "model": "VARCHAR",
    "frames": "INTEGER",
    "held_out": "INTEGER",
    "length_m": "DOUBLE",
    "events": "MAP(VARCHAR, INTEGER)",
    "damage": "VARCHAR",
    "shard": "VARCHAR",
    "digest": "VARCHAR",
}


@dataclass(frozen=True)
class Answer:
    """The result of a query."""

    columns: list[str]
    rows: list[tuple[Any, ...]]


def query(store: Store, sql: str) -> Answer:
    """Answers a query in SQL over the table `segments`."""
    duckdb = _duckdb()
    with duckdb.connect() as database:
        try:
            database.execute(f"CREATE VIEW segments AS SELECT * FROM read_parquet('{_quoted(update(store))}')")
            found = database.execute(sql)
            columns = [column[0] for column in found.description or []]
            return Answer(columns, found.fetchall())
        except duckdb.Error as problem:
            raise TrainerError(f"`{sql}` cannot be answered: {problem}; columns are {', '.join(COLUMNS)}") from None


def update(store: Store) -> Path:
    """Writes the table unless it is newer than all lists of segments and has all columns; returns its file."""
    file = store.folder / CATALOGUE_FILE
    lists = [path.stat().st_mtime_ns for path in (store.folder / "runs").glob("*.json")]
    if file.exists() and file.stat().st_mtime_ns > max(lists, default=0) and _columns(file) == list(COLUMNS):
        return file
    rows = [_row(store, run, entry) for run in store.runs.values() for entry in run.shards]
    partial = file.with_suffix(".partial")
    with _duckdb().connect() as database:
        kinds = ", ".join(f"{name} {kind}" for name, kind in COLUMNS.items())
        database.execute(f"CREATE TABLE segments ({kinds})")
        if rows:
            database.executemany(f"INSERT INTO segments VALUES ({', '.join('?' * len(COLUMNS))})", rows)
        database.execute(f"COPY segments TO '{_quoted(partial)}' (FORMAT parquet)")
    os.replace(partial, file)
    return file


def _columns(file: Path) -> list[str]:
    """The columns of a table. One that an earlier version wrote has fewer."""
    with _duckdb().connect() as database:
        found = database.execute(f"DESCRIBE SELECT * FROM read_parquet('{_quoted(file)}')").fetchall()
    return [row[0] for row in found]


def _row(store: Store, run: Run, entry: Entry) -> list[Any]:
    """The values of all columns for one segment."""
    folder = ArrayFolder(store.shard(entry.shard or ""))
    meta = folder.meta
    recorded = meta["recorded"]
    # Simulations and earlier recordings have no identity.
    identity = recorded.get("identity") or {}
    zero_ns = recorded["zero_unix_ns"]
    began = None if zero_ns is None else datetime.fromtimestamp((zero_ns + meta["first_time_ns"]) / 1e9, UTC)
    values = {
        "folder": run.source,
        "segment": entry.file,
        **{name: identity.get(name) for name in ("robot", "name", "site", "run")},
        "began": None if began is None else began.replace(tzinfo=None),
        "scene": recorded["scene"],
        "policy": recorded["policy"],
        "model": recorded["model_digest"],
        "frames": entry.frames,
        "held_out": meta["held_out"],
        "length_m": meta["length_m"],
        "events": meta["events"],
        "damage": entry.damage,
        "shard": entry.shard,
        "digest": folder.digest,
    }
    return [values[name] for name in COLUMNS]


def _quoted(file: Path) -> str:
    """A path inside a text literal of SQL."""
    return str(file).replace("'", "''")


def _duckdb() -> Any:  # noqa: ANN401
    try:
        import duckdb
    except ImportError:
        raise TrainerError("the catalogue needs DuckDB; run `pip install duckdb`") from None
    return duckdb
