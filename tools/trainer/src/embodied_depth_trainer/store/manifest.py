"""The list of a run's segments and of the shards that were made of them.

It is written again when shards were added. Size and time of modification of a segment's file tell whether it has to
be read again, as in the index of Git; in an object store, size and tag.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically


@dataclass(slots=True)
class Entry:
    """One segment."""

    file: str
    """Name of its file in the run."""
    bytes: int
    modified_ns: int
    digest: str
    """SHA-256 of the file."""
    shard: str | None = None
    """Name of its shard; `None` if none could be made."""
    frames: int = 0
    damage: str | None = None
    """What ends the segment before its end, or why there is no shard."""
    labels: str | None = None
    """Name of its labels."""
    etag: str | None = None
    """Tag of its object, if it is in an object store."""
    signed_by: str | None = None
    """Public key of the robot that signed it; `None` if its signature was not checked or is not valid."""
    signed_digest: str | None = None
    """The digest in its signature."""
    previous: str | None = None
    """The digest of the signed segment before it in its run, as its signature says."""
    refused: str | None = None
    """Why nothing is trained on it (`prepare --robots`). It may have a shard that was made before."""
    refused_with: str | None = None
    """The digest of the known robots when its signature was refused."""


@dataclass
class Run:
    """A run and what has been made of it."""

    source: str
    """The absolute path of its directory, or its URL."""
    entries: dict[str, Entry] = field(default_factory=dict)
    """By the segments' file names."""

    @staticmethod
    def name_of(source: str) -> str:
        """The name of the run in the store: runs of several robots can have equal names."""
        return f"{source.rpartition('/')[2]}-{hashlib.sha256(source.encode()).hexdigest()[:12]}"

    @property
    def in_order(self) -> list[Entry]:
        """The segments in their order: segment 10000 comes after segment 9999."""
        return sorted(self.entries.values(), key=lambda entry: (len(entry.file), entry.file))

    @property
    def shards(self) -> list[Entry]:
        """The segments that have a shard and are not refused, in their order."""
        return [entry for entry in self.in_order if entry.shard is not None and entry.refused is None]


def read_run(file: Path) -> Run:
    try:
        plain: dict[str, Any] = json.loads(file.read_text())
        return Run(plain["source"], {entry["file"]: Entry(**entry) for entry in plain["segments"]})
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise TrainerError(f"{file} is no list of segments ({problem}); remove it and prepare the run again") from None


def write_run(run: Run, file: Path) -> None:
    # A line for each segment, without what is not known of it: a year of a fleet has gigabytes of them otherwise.
    lines = ",\n".join(json.dumps(_known(entry)) for entry in run.entries.values())
    write_atomically(f'{{"source": {json.dumps(run.source)}, "segments": [\n{lines}\n]}}\n'.encode(), file)


def _known(entry: Entry) -> dict[str, Any]:
    values = ((name, getattr(entry, name)) for name in Entry.__slots__)
    return {name: value for name, value in values if value is not None}
