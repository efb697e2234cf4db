"""The tables of a dataset (Parquet)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import parquet

from embodied_depth_trainer.exports.lerobot.layout import ACTION, IMAGE, STATE, TIME

# An encoded image in the form of the library `datasets`: bytes without a path.
_IMAGE = pa.struct([pa.field("bytes", pa.binary(), nullable=False), pa.field("path", pa.string())])
_VECTOR = pa.list_(pa.field("element", pa.float32(), nullable=False))
_INTEGERS = ("frame_index", "episode_index", "index", "task_index")

DATA_SCHEMA = pa.schema(
    [
        pa.field(IMAGE, _IMAGE, nullable=False),
        pa.field(STATE, _VECTOR, nullable=False),
        pa.field(ACTION, _VECTOR, nullable=False),
        pa.field(TIME, pa.float64(), nullable=False),
        pa.field("timestamp", pa.float32(), nullable=False),
        *(pa.field(name, pa.int64(), nullable=False) for name in _INTEGERS),
    ]
)


class DataTable:
    """A data file, which is written one row group at a time."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._sink = path.open("xb")
        plain = [name for name in DATA_SCHEMA.names if name != IMAGE]
        # PNGs are compressed already, all different, and have no meaningful order. Lists have their values one level
        # below their own names.
        columns = [f"{name}.list.element" if name in (STATE, ACTION) else name for name in plain]
        self._writer = parquet.ParquetWriter(
            self._sink,
            DATA_SCHEMA,
            compression={**dict.fromkeys(columns, "SNAPPY"), f"{IMAGE}.bytes": "NONE", f"{IMAGE}.path": "SNAPPY"},
            use_dictionary=columns,
            write_statistics=columns,
        )

    def append(self, columns: dict[str, Any]) -> None:
        """Writes a row group."""
        rows = len(columns["index"])
        arrays = [pa.array(columns[field.name], field.type) for field in DATA_SCHEMA]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=DATA_SCHEMA), row_group_size=rows)

    @property
    def bytes(self) -> int:
        """What was written so far."""
        return self._sink.tell()

    def close(self) -> None:
        self._writer.close()
        self._sink.close()


def write_table(path: Path, columns: dict[str, pa.Array], pandas: dict[str, Any] | None = None) -> None:
    """Writes a small table; `pandas` is the metadata from which pandas restores its index."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = [pa.field(name, array.type, nullable=False) for name, array in columns.items()]
    metadata = None if pandas is None else {"pandas": json.dumps(pandas)}
    table = pa.Table.from_arrays(list(columns.values()), schema=pa.schema(fields, metadata))
    parquet.write_table(table, path, compression="SNAPPY")
