"""The runs of a path and their segments, and what of them cannot be read."""

from __future__ import annotations

import fcntl
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from embodied_depth_trainer.data.messages import SEGMENT_NAME, in_order
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.ticks import read_header


@dataclass(frozen=True)
class Run:
    """The segments of one run."""

    path: Path
    """The directory of the run, or the one segment."""
    segments: tuple[Path, ...]
    """In the order of recording."""
    unread: tuple[str, ...] = ()
    """What cannot be read, a sentence for each."""
    missing: tuple[str, ...] = ()
    """The segments between others that are not there."""

    def check_order(self) -> None:
        """Refuses segments that do not have the order of their ticks, because an export would then run backwards."""
        before: tuple[Path, int] | None = None
        for file in self.segments:
            header = read_header(file)
            if header is None:
                continue
            first = int(header["first_tick"])
            if before is not None and before[1] >= first:
                raise TrainerError(
                    f"{file}: begins at tick {first}, but {before[0]} before it at tick {before[1]}; name the segments "
                    "of a run in the order of their ticks, and put each run into a directory of its own"
                )
            before = file, first

    @property
    def bytes(self) -> int:
        return sum(file.stat().st_size for file in self.segments)


def runs(path: Path) -> list[Run]:
    """The run of a directory or of one segment; or, if the directory holds no segment, the runs below it."""
    if path.is_file():
        return [_run(path, [path])]
    if not path.is_dir():
        raise TrainerError(f"{path} does not exist; give a directory of runs, the directory of one run, or one segment")
    own = _segments(path)
    if own:
        return [_run(path, own)]
    folders = sorted(folder for folder in path.iterdir() if folder.is_dir() and not folder.is_symlink())
    found = [_run(folder, files) for folder in folders if (files := _segments(folder))]
    if not found:
        raise TrainerError(
            f"{path} contains no recording_NNNN.mcap; give a directory of runs, the directory of one run, or one "
            "segment"
        )
    return found


def is_run(path: Path) -> bool:
    """Whether the path is that of one run, not that of a directory of runs."""
    return path.is_file() or bool(_segments(path))


def is_being_written(file: Path) -> bool:
    """A recorder holds a lock on the segment that it writes."""
    with file.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


def _segments(folder: Path) -> list[Path]:
    try:
        return in_order([file for file in folder.iterdir() if re.fullmatch(SEGMENT_NAME, file.name)])
    except OSError as problem:
        raise TrainerError(f"cannot read {folder}: {problem}; run this as the account that recorded it") from None


def _run(path: Path, files: Sequence[Path]) -> Run:
    unread = {file: why for file in files if (why := _why_unread(file)) is not None}
    readable = tuple(file for file in files if file not in unread)
    if not readable:
        raise TrainerError(next(iter(unread.values())))
    return Run(path, readable, tuple(unread.values()), tuple(_gaps(files)))


def _why_unread(file: Path) -> str | None:
    if file.is_symlink():
        return (
            f"cannot read {file}: it is a symbolic link, which is not followed; give the directory that it points into"
        )
    try:
        file.open("rb").close()
    except OSError as problem:
        return f"cannot read {file}: {problem.strerror}; run this as the account that recorded it"
    return None


def _gaps(files: Sequence[Path]) -> list[str]:
    """The segments between others that are not there: the robot deleted them for space, or they were not copied."""
    numbers = [int(file.stem.rpartition("_")[2]) for file in files if re.fullmatch(SEGMENT_NAME, file.name)]
    gaps = [(first + 1, last - 1) for first, last in pairwise(numbers) if last - first > 1]
    return [_name(first) if first == last else f"{_name(first)} to {_name(last)}" for first, last in gaps]


def _name(number: int) -> str:
    return f"recording_{number:04}.mcap"
