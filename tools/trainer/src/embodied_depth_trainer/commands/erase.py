"""`embodied-depth erase`: erases runs from a store and from an object store."""

from __future__ import annotations

import argparse
import os
import sys
from datetime import UTC, datetime
from pathlib import Path

from embodied_depth_trainer.store.erase import Erasure, erasure
from embodied_depth_trainer.store.sources import is_url
from embodied_depth_trainer.store.store import Store


def add_erase(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "run",
        help="directory of one run, or its URL in an object store; of a URL, the objects are erased as well",
    )
    command.add_argument("--store", type=Path, required=True, help="the store that `prepare` has made")
    command.add_argument(
        "--unlisted",
        action="store_true",
        help="also erase what no list names, as `prepare --prune` does: shards of earlier states of a segment, and "
        "what killed processes have left. Not while `prepare` runs",
    )
    command.add_argument("--yes", action="store_true", help="erase; without it, only print what would be erased")


def run_erase(options: argparse.Namespace) -> int:
    source = options.run.rstrip("/") if is_url(options.run) else os.path.realpath(options.run)
    found = erasure(Store(options.store), source, options.unlisted)
    print("\n".join(_lines(found, options.yes)), flush=True)
    if not options.yes:
        print("nothing was erased; give --yes", file=sys.stderr)
        return 0
    found.erase()
    print("erased", flush=True)
    return 0


def _lines(found: Erasure, is_final: bool) -> list[str]:
    """The receipt, and what stays. It is printed first: nothing is erased if it cannot be."""
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    lines = [f"{now}: {'erasing' if is_final else 'would erase'} {found.run.source}", *found.receipt()]
    if found.shared:
        lines.append(f"kept, because other runs have the same segments: {', '.join(found.shared)}")
    for version, shards in found.versions.items():
        lines.append(f"{version} names {shards} of the erased shards: models trained on it have learnt from this run")
    if found.unread:
        lines.append(f"not searched, because they cannot be read: {', '.join(found.unread)}")
    if found.unlisted:
        lines.append(
            f"kept: {len(found.unlisted)} folders that no list names and that may hold images of this run, for "
            f"instance {found.unlisted[0]}; --unlisted erases them, too"
        )
    if not is_url(found.run.source) and Path(found.run.source).is_dir():
        lines.append(
            f"kept: the recordings themselves, from which the next `prepare` makes this again; "
            f"`firmware-host buffer erase {found.run.source} --yes` erases them"
        )
    return lines
