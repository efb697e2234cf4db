"""Recorded runs, in directories or in an object store, and how their segments come onto the disk."""

from __future__ import annotations

import fnmatch
import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from embodied_depth_trainer.data.messages import SEGMENT_NAME, segments
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import process_name
from embodied_depth_trainer.store.bucket import StoredObject, download, list_objects
from embodied_depth_trainer.store.manifest import Entry

# Suffix of a segment that `pull-buffer --encrypt-to` encrypted.
ENCRYPTED = ".age"


@dataclass(frozen=True)
class LocalSegment:
    """A segment in a directory."""

    # Text instead of a path, because a path costs more than to ask the file system about it.
    folder: str
    name: str

    def __str__(self) -> str:
        return f"{self.folder}/{self.name}"

    @property
    def file(self) -> Path:
        return Path(self.folder, self.name)

    def entry(self) -> Entry:
        """What its run lists of it, without a digest."""
        state = self.file.stat()
        return Entry(self.name, state.st_size, state.st_mtime_ns, "")

    def state(self) -> str:
        """What changes when the file does."""
        state = os.stat(str(self))
        return f"{state.st_size} {state.st_mtime_ns}"

    def is_known(self, entry: Entry) -> bool:
        """Whether the file is the one that the entry was made of."""
        state = os.stat(str(self))
        return (entry.bytes, entry.modified_ns) == (state.st_size, state.st_mtime_ns)

    def on_disk(self, scratch: Path) -> AbstractContextManager[Path]:
        """Its file, while the context lasts."""
        return nullcontext(self.file)


@dataclass(frozen=True)
class RemoteSegment:
    """A segment in an object store."""

    url: str
    """The URL that was listed."""
    listed: StoredObject

    def __str__(self) -> str:
        return f"{self.url}/{self.listed.path}"

    @property
    def name(self) -> str:
        return self.listed.path.rpartition("/")[2]

    def entry(self) -> Entry:
        return Entry(self.name, self.listed.bytes, self.listed.modified_ns, "", etag=self.listed.etag)

    def state(self) -> str:
        """What changes when the object does."""
        return f"{self.listed.bytes} {self.listed.etag or self.listed.modified_ns}"

    def is_known(self, entry: Entry) -> bool:
        """Whether the object is the one that the entry was made of: by its tag if there is one, else by its time."""
        if self.listed.etag is not None and entry.etag is not None:
            return (entry.bytes, entry.etag) == (self.listed.bytes, self.listed.etag)
        return (entry.bytes, entry.modified_ns) == (self.listed.bytes, self.listed.modified_ns)

    @contextmanager
    def on_disk(self, scratch: Path) -> Iterator[Path]:
        folder = scratch / process_name()
        try:
            self._download(folder)
            yield folder / self.name
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _download(self, folder: Path) -> None:
        try:
            # Images of a home are private.
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            download(self.url, self.listed, folder / self.name)
        except OSError as problem:
            raise TrainerError(f"cannot write {folder}: {problem}; free some space or give another --out") from problem


RecordedSegment = LocalSegment | RemoteSegment


@dataclass(frozen=True)
class RecordedRun:
    """A run and its segments, in their order."""

    source: str
    """Absolute path or URL."""
    segments: tuple[RecordedSegment, ...]


def is_url(source: Path | str) -> bool:
    """Whether a source is in an object store."""
    return isinstance(source, str) and "://" in source


def is_encrypted(listed: StoredObject) -> bool:
    """Whether an object is an encrypted segment."""
    name = listed.path.rpartition("/")[2]
    return name.endswith(ENCRYPTED) and re.fullmatch(SEGMENT_NAME, name.removesuffix(ENCRYPTED)) is not None


def find_runs(source: Path | str) -> Iterator[RecordedRun]:
    """All runs below a directory or a URL, as they are found, so that memory holds one of them at a time."""
    return _in_bucket(str(source)) if is_url(source) else _in_directory(Path(source))


def _in_directory(source: Path) -> Iterator[RecordedRun]:
    if not source.is_dir():
        raise TrainerError(f"{source} is no directory; give the --out directory of a run, or one that holds runs")
    for folder, below, files in os.walk(source):
        below.sort()
        if fnmatch.filter(files, "recording_*.mcap"):
            names = sorted(
                (file for file in files if re.fullmatch(SEGMENT_NAME, file)), key=lambda name: (len(name), name)
            )
            if not names:
                # Names what is missing.
                segments(Path(folder))
            yield RecordedRun(os.path.realpath(folder), tuple(LocalSegment(folder, name) for name in names))


def _in_bucket(url: str) -> Iterator[RecordedRun]:
    """The runs that `pull-buffer` uploaded, `RUN/recording_NNNN.mcap` at any depth. A listing has the objects of a
    folder one after the other. A store that lists in another order gives a run in several parts."""
    url = url.rstrip("/")
    encrypted = _Encrypted()
    recorded = (RemoteSegment(url, listed) for listed in list_objects(url) if not encrypted.has(listed))
    wanted = (segment for segment in recorded if re.fullmatch(SEGMENT_NAME, segment.name))
    is_empty = True
    for folder, parts in groupby(wanted, key=lambda segment: segment.listed.path.rpartition("/")[0]):
        is_empty = False
        in_order = sorted(parts, key=lambda segment: (len(segment.name), segment.name))
        yield RecordedRun(f"{url}/{folder}".rstrip("/"), tuple(in_order))
    if encrypted.count:
        left_out = (
            f"{url}: encrypted segments are left out: {encrypted.count}, such as {encrypted.first}; decrypt them with "
            f"`pull-buffer {url} DIR --identity key.txt`, and prepare DIR"
        )
        if is_empty:
            raise TrainerError(left_out)
        print(left_out, file=sys.stderr)
    if is_empty:
        raise TrainerError(f"{url} holds no recording_NNNN.mcap; give the URL that `pull-buffer` uploads to")


@dataclass
class _Encrypted:
    """The encrypted segments of a listing."""

    count: int = 0
    first: str = ""

    def has(self, listed: StoredObject) -> bool:
        """Whether this object is one of them."""
        if not is_encrypted(listed):
            return False
        self.first = self.first or listed.path
        self.count += 1
        return True
