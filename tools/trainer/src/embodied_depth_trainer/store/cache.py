"""Files of an object store on the disk, as many as fit into a number of bytes: those not used for longest are deleted.

    CACHE/files/SHA256           a complete file, named by the digest of its bytes
    CACHE/files/SHA256.partial   one that is being downloaded; it has its final length from the beginning
    CACHE/lock                   held while files are chosen for deletion

The folder is the only state, so any number of threads and processes of a computer may share it, and each may be killed
at any time. A file has its name when its digest was compared. A partial file is locked by the process that writes it;
the kernel removes the lock of a killed one, and then the file is deleted or written again. A file that is deleted while
another process reads it stays readable for that process.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError

PARTIAL = ".partial"
# Between two questions whether the downloads of others, which fill the cache, are complete.
PAUSE_S = 0.02

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
            raise self._unwritable(problem) from problem

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
            stream = FileIO(self.files / digest)
        except FileNotFoundError:
            return None
        os.utime(stream.fileno())
        return stream

    def check(self, digest: str) -> None:
        """Deletes the file if it is there and has another digest."""
        try:
            with FileIO(self.files / digest) as stream:
                is_sound = hashlib.file_digest(stream, "sha256").hexdigest() == digest
        except OSError:
            is_sound = False
        if not is_sound:
            (self.files / digest).unlink(missing_ok=True)

    def _downloaded(self, digest: str, size: int, download: Download) -> FileIO | None:
        """Downloads the file; `None` if another thread or process did so meanwhile."""
        partial = self.files / f"{digest}{PARTIAL}"
        stream = _created(partial)
        try:
            fcntl.flock(stream, fcntl.LOCK_EX)
            if not _is_at(stream, partial):
                stream.close()
                return None
            try:
                self._reserve(stream, size)
                _fill(stream, digest, download)
                # Who adds up the lengths of all files sees it under one of its names.
                with locked(self.folder / "lock"):
                    partial.rename(self.files / digest)
            except BaseException:
                # Before the lock is released, so that no other process takes it for its own.
                partial.unlink(missing_ok=True)
                raise
            fcntl.flock(stream, fcntl.LOCK_UN)
            stream.seek(0)
        except BaseException as problem:
            stream.close()
            if isinstance(problem, OSError):
                raise self._unwritable(problem) from problem
            raise
        return stream

    def _reserve(self, stream: FileIO, size: int) -> None:
        """Gives the file its length, as soon as that many bytes of the limit are free."""
        while True:
            with locked(self.folder / "lock"):
                if self._free(size):
                    stream.truncate(size)
                    return
            time.sleep(PAUSE_S)

    def _free(self, size: int) -> bool:
        """Deletes what was not used for longest until `size` bytes are free; `False` if what others download now leaves
        less than that."""
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
            return False
        free = self.limit - written - sum(length for _, length, _ in complete)
        for _, length, path in sorted(complete):
            if free >= size:
                break
            os.unlink(path)
            free += length
        return True

    def _unwritable(self, problem: OSError) -> TrainerError:
        return TrainerError(
            f"cannot write {self.folder}: {problem}; free some space, or give less --cache-bytes or another --cache"
        )


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """Holds a lock that one thread of all processes has, while the context lasts."""
    with _created(file) as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


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
