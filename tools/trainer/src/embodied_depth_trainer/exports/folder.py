"""The folder of an export: it appears when it is complete, it replaces nothing of the user, and it knows what it was
made of, so that a run that has grown is exported again."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.runs import Run
from embodied_depth_trainer.exports.ticks import read_header

RECORD = "export.json"
"""The file in each export that says what it was made of."""
# At most this many names are tried.
_MAX_NAMES = 1000


@dataclass(frozen=True)
class Origin:
    """What an export is made of. As for `pull-buffer`, a segment of the same size and modification time is the same."""

    layout: str
    run: str
    """Digest of what is the same in the header of every segment of a run, and contains the identity of a real run."""
    segments: list[list[str | int]]
    """Name, bytes and modification time of each segment."""

    @staticmethod
    def of(layout: str, run: Run) -> Origin:
        states = [(file.name, file.stat()) for file in run.segments]
        header = next((header for file in run.segments if (header := read_header(file)) is not None), {})
        digest = hashlib.sha256(json.dumps(header.get("run"), sort_keys=True).encode()).hexdigest()
        return Origin(layout, digest, [[name, state.st_size, state.st_mtime_ns] for name, state in states])

    def is_of_same_run(self, other: Origin) -> bool:
        """Whether both are exports of one run in one format, which may have grown in the meantime."""
        return (self.layout, self.run) == (other.layout, other.run)


@dataclass(frozen=True)
class Exported:
    """What an export's record says."""

    origin: Origin
    left_out: list[str]
    """What could not be exported, a phrase for each."""


def read_exported(folder: Path, origin: Origin) -> Exported | None:
    """The record of an earlier export of the same run; `None` when nothing is there. Anything else is refused."""
    # Also a link to nothing is something.
    if not os.path.lexists(folder):
        return None
    try:
        record = json.loads((folder / RECORD).read_text())
        earlier = Exported(Origin(**record["origin"]), list(record["left_out"]))
    except (OSError, ValueError, KeyError, TypeError):
        raise TrainerError(f"{folder} is there already and is not overwritten; choose another --out") from None
    if not earlier.origin.is_of_same_run(origin):
        raise TrainerError(
            f"{folder} is there already, of another run or in another format, and is not overwritten; choose another "
            "--out"
        )
    return earlier


def write_folder(to: Path, origin: Origin, fill: Callable[[Path], Exported]) -> Exported:
    """Creates the folder `to`, or replaces an earlier export of the same run: `fill` writes into a temporary folder
    beside it."""
    earlier = read_exported(to, origin)
    with _beside(to) as scratch:
        # The files of a bag have the name of its folder.
        partial = scratch / to.name
        exported = fill(partial)
        try:
            (partial / RECORD).write_text(json.dumps(asdict(exported), indent=1))
            _sync(partial)
            if earlier is None:
                _give_name(partial, to)
            else:
                _replace(to, partial, scratch / "earlier")
        except OSError as problem:
            raise _not_written(to, problem) from problem
    return exported


@contextmanager
def _beside(to: Path) -> Iterator[Path]:
    """A temporary folder, which no other process uses and which replaces no file of the user."""
    try:
        to.parent.mkdir(parents=True, exist_ok=True)
        scratch = _scratch(to)
    except OSError as problem:
        raise _not_written(to, problem) from problem
    try:
        yield scratch
    finally:
        # The error that is raised is the first one; failing to remove the temporary folder adds nothing.
        shutil.rmtree(scratch, ignore_errors=True)


def _scratch(to: Path) -> Path:
    for number in range(_MAX_NAMES):
        scratch = to.with_name(f"{to.name}.{os.getpid()}-{number}.partial")
        try:
            scratch.mkdir()
        except FileExistsError:
            continue
        return scratch
    raise FileExistsError(f"{_MAX_NAMES} names like {scratch.name} are taken")


def _give_name(partial: Path, to: Path) -> None:
    try:
        # A directory that is not empty is not replaced by this.
        partial.rename(to)
    except OSError:
        if os.path.lexists(to):
            raise TrainerError(f"{to} is there already and is not overwritten; choose another --out") from None
        raise


def _replace(to: Path, partial: Path, earlier: Path) -> None:
    """A kill between the two moves leaves both exports in the temporary folder, and a person can move them back."""
    to.rename(earlier)
    try:
        _give_name(partial, to)
    except (OSError, TrainerError):
        if not os.path.lexists(to):
            earlier.rename(to)
        raise


def _sync(folder: Path) -> None:
    """Has all files on the disk before the folder gets its name, so that a power cut leaves no incomplete export."""
    for file in folder.rglob("*"):
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())


def _not_written(to: Path, problem: OSError) -> TrainerError:
    return TrainerError(f"cannot write {to}: {problem}; create the folder, free space, or choose another --out")
