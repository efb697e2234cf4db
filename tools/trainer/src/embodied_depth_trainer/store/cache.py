"""Files of an object store on the disk, as many as fit into a number of bytes: those not used for longest are deleted.

    CACHE/files/SHA256           a complete file, named by the digest of its bytes
    CACHE/files/SHA256.partial   one that is being downloaded; it has its final length from the beginning
    CACHE/lock                   held while files are chosen for deletion; has the number of bytes of all files, or more

The folder is the only state, so any number of threads and processes of a computer may share it, and each may be killed
at any time. A file has its name when its digest was compared. A partial file is locked by the process that writes it;
the kernel removes the lock of a killed one, and then the file is deleted or written again. A file that is deleted while
another process reads it stays readable for that process.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError

PARTIAL = ".partial"
DIGEST = re.compile("[0-9a-f]{64}")
# Between two questions whether the downloads of others, which fill the cache, are complete; the first, and the longest.
PAUSE_S = 0.02
LONGEST_PAUSE_S = 1.0
# Files are deleted until only this share of the bytes is used, since the whole folder must be read to choose them.
EMPTIED_TO = 0.95

Download = Callable[[], Iterable[bytes]]


class DigestError(Exception):
    """What was downloaded has another digest."""


class Cache:
    """A folder of files with at most `limit` bytes in all."""

    def __init__(self, folder: Path, limit: int) -> None:
        self.folder = folder
        self.limit = limit
        self.files = folder / "files"
        try:
            # Images of a home are private.
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.files.mkdir(mode=0o700, exist_ok=True)
        except OSError as problem:
            raise self._unusable(problem) from problem

    def open(self, digest: str, size: int, download: Download) -> FileIO:
        """The file with this SHA-256 and length, which is downloaded if it is not there."""
        if size > self.limit:
            raise TrainerError(
                f"a file of {size:,} bytes does not fit into the cache {self.folder} of {self.limit:,} bytes; give at "
                f"least --cache-bytes {size}"
            )
        # What another process has just downloaded, a third one may have deleted already.
        while (found := self.find(digest) or self._downloaded(digest, size, download)) is None:
            pass
        return found

    def find(self, digest: str) -> FileIO | None:
        """The file, if it is there; it is then the one that was used last."""
        try:
            stream = FileIO(self._file(digest))
            os.utime(stream.fileno())
        except FileNotFoundError:
            return None
        except OSError as problem:
            raise self._unusable(problem) from problem
        return stream

    def check(self, digest: str) -> None:
        """Deletes the file if it is there and has another digest."""
        try:
            with FileIO(self._file(digest)) as stream:
                is_sound = hashlib.file_digest(stream, "sha256").hexdigest() == digest
            if not is_sound:
                self._file(digest).unlink(missing_ok=True)
        except FileNotFoundError:
            pass
        except OSError as problem:
            raise self._unusable(problem) from problem

    def _file(self, digest: str) -> Path:
        # Digests come from an object store: no other file of this computer is named by one.
        if not is_sha256(digest):
            raise ValueError(f"{digest!r} is no SHA-256")
        return self.files / digest

    def _downloaded(self, digest: str, size: int, download: Download) -> FileIO | None:
        """Downloads the file; `None` if another thread or process did so meanwhile."""
        partial = self._file(digest).with_suffix(PARTIAL)
        try:
            stream = _created(partial)
        except OSError as problem:
            raise self._unusable(problem) from problem
        try:
            fcntl.flock(stream, fcntl.LOCK_EX)
            if not _is_at(stream, partial):
                stream.close()
                return None
            try:
                # Another may have completed the file after it was not found here and before this partial file was made.
                if (found := self.find(digest)) is not None:
                    partial.unlink()
                    stream.close()
                    return found
                # What a killed process has left of it would be counted beside it.
                stream.truncate(0)
                self._reserve(stream, size)
                _fill(stream, digest, download)
                # Who adds up the lengths of all files sees it under one of its names.
                with locked(self.folder / "lock"):
                    partial.rename(self._file(digest))
            except BaseException:
                # Before the lock is released, so that no other process takes it for its own.
                partial.unlink(missing_ok=True)
                raise
            fcntl.flock(stream, fcntl.LOCK_UN)
            stream.seek(0)
        except BaseException as problem:
            stream.close()
            if isinstance(problem, OSError):
                raise self._unusable(problem) from problem
            raise
        return stream

    def _reserve(self, stream: FileIO, size: int) -> None:
        """Gives the file its length, as soon as that many bytes of the limit are free."""
        pause = PAUSE_S
        while True:
            with locked(self.folder / "lock") as lock:
                used = _number_in(lock)
                if used is None or used + size > self.limit:
                    used = self._freed(size)
                if used is not None:
                    # First, because a number that is too large does no harm if the process is killed here.
                    _write_number(lock, used + size)
                    stream.truncate(size)
                    return
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE_S)

    def _freed(self, size: int) -> int | None:
        """Deletes what was not used for longest until `size` bytes are free. The bytes of all files that remain; `None`
        if what others download now leaves less than `size`."""
        complete, written = [], 0
        for entry in os.scandir(self.files):
            # Another process may complete it at this moment, or give it up.
            with suppress(FileNotFoundError):
                state = entry.stat()
                if not entry.name.endswith(PARTIAL):
                    complete.append((state.st_mtime_ns, state.st_size, entry.path))
                elif not _removed_if_abandoned(Path(entry.path)):
                    written += state.st_size
        if written + size > self.limit:
            return None
        used = written + sum(length for _, length, _ in complete)
        if used + size <= self.limit:
            return used
        for _, length, path in sorted(complete):
            if used + size <= EMPTIED_TO * self.limit:
                break
            # It may have been deleted by a check meanwhile.
            Path(path).unlink(missing_ok=True)
            used -= length
        return used

    def _unusable(self, problem: OSError) -> TrainerError:
        return TrainerError(
            f"cannot use {self.folder}: {problem}; free some space, or give less --cache-bytes or another --cache"
        )


def is_sha256(text: str) -> bool:
    return DIGEST.fullmatch(text) is not None


@contextmanager
def locked(file: Path) -> Iterator[FileIO]:
    """Holds a lock that one thread of all processes has, while the context lasts."""
    with _created(file) as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield stream


def _number_in(lock: FileIO) -> int | None:
    lock.seek(0)
    text = lock.readall()
    # A process may have been killed while it wrote.
    return int(text) if text.endswith(b"\n") and text.strip().isdigit() else None


def _write_number(lock: FileIO, number: int) -> None:
    lock.truncate(0)
    lock.seek(0)
    lock.write(b"%d\n" % number)


def _created(file: Path) -> FileIO:
    """A file that is opened with its content, or made empty."""
    return FileIO(os.open(file, os.O_RDWR | os.O_CREAT, 0o600), "r+")


def _is_at(stream: FileIO, file: Path) -> bool:
    """Whether an opened file still has this name."""
    try:
        return os.path.samestat(os.fstat(stream.fileno()), file.stat())
    except FileNotFoundError:
        return False


def _removed_if_abandoned(partial: Path) -> bool:
    """Deletes a file that no process writes any more."""
    with FileIO(partial) as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        if _is_at(stream, partial):
            partial.unlink()
    return True


def _fill(stream: FileIO, digest: str, download: Download) -> None:
    found = hashlib.sha256()
    stream.seek(0)
    for piece in download():
        found.update(piece)
        rest = memoryview(piece)
        while rest:
            rest = rest[stream.write(rest) :]
    if found.hexdigest() != digest:
        raise DigestError(found.hexdigest())
