"""`embodied-depth provenance`: says what a model was trained on."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.export.provenance import Provenance
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import ListedDump, ListedShard, remembered


def add_provenance(command: argparse.ArgumentParser) -> None:
    command.add_argument("model", type=Path, help="ONNX file that `export`, `watch` or `make-default` wrote")
    command.add_argument(
        "--store", type=Path, action="append", default=[], help="store that it was trained on: names the segments"
    )


def run_provenance(options: argparse.Namespace) -> None:
    provenance = Provenance(options.model)
    print("\n".join(provenance.lines()))
    stores = [Store(folder) for folder in options.store]
    for name in provenance.datasets if stores else ():
        version = remembered(name, stores)
        print(f"dataset {name}:")
        for item in version.listed:
            print(f"  {_named(item, stores)}")


def _named(item: ListedShard | ListedDump, stores: list[Store]) -> str:
    """A segment or a dump, and whether its shard is still in a store."""
    if isinstance(item, ListedDump):
        return f"{item.folder}, {item.frames} frames"
    kept = any(store.shard(item.shard).is_dir() for store in stores)
    return f"{item.folder}/{item.segment}, {item.frames} frames{'' if kept else ', not in the store any more'}"
