"""One table of all segments of a store: `catalogue.parquet`, which DuckDB, Polars and pandas read.

DuckDB writes it and answers queries: one package without further ones, and SQL is known. A query reads the table and
the times of the lists of segments; shards are opened once, when their runs are new.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import process_name
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError, digest_in
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
    "labels": "VARCHAR",
    "labels_digest": "VARCHAR",
}
# Key in the table's own metadata: the lists that it was made of, each with its time of modification and its size.
LISTS = "lists"
# The name of a run in the store (`Run.name_of`), and the order of all segments. The table has the runs that were read
# last at its end, because only then it can be written without sorting it.
LIST_OF = "regexp_extract(folder, '[^/]*$') || '-' || left(sha256(folder), 12)"
IN_ORDER = f"{LIST_OF}, length(segment), segment"
# DuckDB holds buffers of these sizes. Its own, 16 MiB and 122,880 rows, are made for fewer columns.
MOST_OF_A_ROW = 1_000_000
ROWS_OF_A_GROUP = 20_480
Lists = dict[str, list[int]]


@dataclass(frozen=True)
class Answer:
    """The result of a query."""

    columns: list[str]
    rows: list[tuple[Any, ...]]


def query(folder: Path, sql: str, values: Sequence[object] = ()) -> Answer:
    """Answers a query in SQL over the table `segments` of a store, or of a table without its store; `values` replace
    its question marks."""
    file = folder if folder.is_file() else update(folder)
    duckdb = _duckdb()
    with duckdb.connect() as database:
        try:
            database.execute(f"CREATE VIEW segments AS SELECT * FROM read_parquet({_text(file)})")
            found = database.execute(sql, list(values))
            columns = [column[0] for column in found.description or []]
            return Answer(columns, found.fetchall())
        except duckdb.Error as problem:
            raise TrainerError(f"`{sql}` cannot be answered: {problem}; columns are {', '.join(COLUMNS)}") from None


def update(folder: Path) -> Path:
    """Reads the runs whose lists have changed since the table was written, writes it if there are any, and returns its
    file."""
    file = folder / CATALOGUE_FILE
    known = _lists_of(file)
    now = _lists_in(folder / "runs")
    if known == now:
        return file
    store = Store(folder)
    kept = {name for name, state in (known or {}).items() if now.get(name) == state}
    with _scratch(file) as (rows, partial):
        with rows.open("w") as stream:
            for name in [name for name in now if name not in kept]:
                for row in _rows(store, store.runs[name]):
                    stream.write(json.dumps(row) + "\n")
        _write(file, kept, rows, now, partial)
        os.replace(partial, file)
    return file


def _lists_of(file: Path) -> Lists | None:
    """The lists that a table was made of; `None` if there is no table, or one that an earlier version wrote."""
    if not file.exists():
        return None
    with _duckdb().connect() as database:
        columns = database.execute(f"DESCRIBE SELECT * FROM read_parquet({_text(file)})").fetchall()
        found = database.execute(
            f"SELECT value FROM parquet_kv_metadata({_text(file)}) WHERE key = ?", [LISTS.encode()]
        ).fetchone()
    if found is None or [column[0] for column in columns] != list(COLUMNS):
        return None
    lists: Lists = json.loads(found[0])
    return lists


def _lists_in(folder: Path) -> Lists:
    """The lists of a store as they are now, in the order of their names."""
    if not folder.is_dir():
        return {}
    with os.scandir(folder) as files:
        states = {file.name[:-5]: file.stat() for file in files if file.name.endswith(".json")}
    return {name: [state.st_mtime_ns, state.st_size] for name, state in sorted(states.items())}


@contextmanager
def _scratch(file: Path) -> Iterator[tuple[Path, Path]]:
    """Files for new rows and for the new table, which are removed afterwards."""
    files = [file.with_name(f".{file.name}.{process_name()}.{kind}") for kind in ("rows", "partial")]
    try:
        yield files[0], files[1]
    finally:
        for scratch in files:
            scratch.unlink(missing_ok=True)


def _write(file: Path, kept: Collection[str], rows: Path, lists: Lists, partial: Path) -> None:
    """Writes the rows of the runs that are kept from the table, and new ones, as a new table."""
    columns = "{" + ", ".join(f"{name}: {_text(kind)}" for name, kind in COLUMNS.items()) + "}"
    form = f"format = 'newline_delimited', columns = {columns}, maximum_object_size = {MOST_OF_A_ROW}"
    found = f"SELECT * FROM read_json({_text(rows)}, {form})"
    with _duckdb().connect() as database:
        # One thread that need not keep the order holds a quarter of the memory.
        database.execute("SET threads = 1; SET preserve_insertion_order = false")
        if kept:
            database.execute("CREATE TABLE kept AS SELECT unnest(?) AS list", [list(kept)])
            old = f"SELECT * FROM read_parquet({_text(file)}) WHERE {LIST_OF} IN (FROM kept)"
            found = f"{old} UNION ALL {found}"
        lists_text = _text(json.dumps(lists))
        database.execute(
            f"COPY ({found}) TO {_text(partial)} "
            f"(FORMAT parquet, ROW_GROUP_SIZE {ROWS_OF_A_GROUP}, KV_METADATA {{{LISTS}: {lists_text}}})"
        )


def _rows(store: Store, run: Run) -> Iterator[dict[str, Any]]:
    """The values of all columns for each segment of a run."""
    return (_row(store, run, entry) for entry in run.shards)


def _row(store: Store, run: Run, entry: Entry) -> dict[str, Any]:
    folder = ArrayFolder(store.shard(entry.shard or ""))
    meta = folder.meta
    recorded = meta["recorded"]
    # Simulations and earlier recordings have no identity.
    identity = recorded.get("identity") or {}
    zero_ns = recorded["zero_unix_ns"]
    began = None if zero_ns is None else datetime.fromtimestamp((zero_ns + meta["first_time_ns"]) / 1e9, UTC)
    return {
        "folder": run.source,
        "segment": entry.file,
        **{name: identity.get(name) for name in ("robot", "name", "site", "run")},
        "began": None if began is None else began.replace(tzinfo=None).isoformat(" "),
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
        "labels": entry.labels,
        "labels_digest": _labels_digest(store, entry),
    }


def _labels_digest(store: Store, entry: Entry) -> str | None:
    """The digest of a segment's labels; `None` if it has none, as after an interruption."""
    if entry.labels is None:
        return None
    try:
        return digest_in(store.labels(entry.labels))
    except DamagedError:
        return None


def _text(value: object) -> str:
    """A text literal of SQL."""
    return "'" + str(value).replace("'", "''") + "'"


def _duckdb() -> Any:  # noqa: ANN401
    try:
        import duckdb
    except ImportError:
        raise TrainerError("the catalogue needs DuckDB; run `pip install duckdb`") from None
    return duckdb
