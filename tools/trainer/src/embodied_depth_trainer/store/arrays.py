"""A folder of NumPy arrays with their digests, which appears completely or not at all.

`np.load(FOLDER / "rgb.npy", mmap_mode="r")` maps an array, `sha256sum -c SHA256SUMS` checks all of them. The trainer
copies single rows by `pread` instead of a map: a map of a file that is cut meanwhile ends the process (SIGBUS), and
every page that was touched counts as the process's own memory. The kernel's page cache keeps what is used often.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import process_name
from embodied_depth_trainer.store.cache import is_sha256

META_FILE = "meta.json"
SUMS_FILE = "SHA256SUMS"
# The header of an array has 128 bytes; one that is longer is no array of a shard.
HEADER_BYTES = 1024
Value = TypeVar("Value", bound=np.generic)


class DamagedError(TrainerError):
    """A folder is not what was written."""


class FolderWriter:
    """Writes a folder whose arrays have `count` rows each."""

    def __init__(self, folder: Path, count: int) -> None:
        self.folder = folder
        self.count = count
        # Two processes that make the same folder do not meet.
        self.partial = folder.with_name(f".{folder.name}.{process_name()}.partial")
        shutil.rmtree(self.partial, ignore_errors=True)
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            # Images of a home are private.
            self.partial.mkdir(mode=0o700)
        except OSError as problem:
            raise self._unwritable(problem) from problem
        self.digests: dict[str, Any] = {}
        self.rows: dict[str, int] = {}

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Appends rows [n, ...] to an array."""
        data = np.ascontiguousarray(rows)
        file = f"{name}.npy"
        begins = file not in self.digests
        if begins:
            self.digests[file] = hashlib.sha256()
            self.rows[name] = 0
        self.rows[name] += len(rows)
        try:
            with (self.partial / file).open("ab") as stream:
                for part in (_header((self.count, *rows.shape[1:]), rows.dtype) if begins else b"", data.data):
                    stream.write(part)
                    self.digests[file].update(part)
        except OSError as problem:
            raise self._unwritable(problem) from problem

    def finish(self, meta: dict[str, Any]) -> None:
        """Writes what describes the arrays, and makes the folder appear."""
        assert all(rows == self.count for rows in self.rows.values()), f"{self.rows} rows instead of {self.count}"
        text = json.dumps(meta, indent=1, sort_keys=True).encode()
        self.digests[META_FILE] = hashlib.sha256(text)
        sums = "".join(f"{found.hexdigest()}  {name}\n" for name, found in sorted(self.digests.items()))
        try:
            (self.partial / META_FILE).write_bytes(text)
            (self.partial / SUMS_FILE).write_text(sums)
            for file in self.partial.iterdir():
                with file.open("rb") as stream:
                    os.fsync(stream.fileno())
            self._appear()
        except OSError as problem:
            raise self._unwritable(problem) from problem

    def abandon(self) -> None:
        """Removes what has been written."""
        shutil.rmtree(self.partial, ignore_errors=True)

    def _appear(self) -> None:
        try:
            self.partial.rename(self.folder)
        except OSError:
            # Another process was faster; equal names have equal contents.
            if not (self.folder / SUMS_FILE).exists():
                raise
            self.abandon()

    def _unwritable(self, problem: OSError) -> TrainerError:
        self.abandon()
        return TrainerError(f"cannot write {self.folder}: {problem}; free some space or give another --out")


class StoredArray(Generic[Value]):
    """Every `every`th row of one array of a folder. Each access opens the file, so any number of arrays costs no
    file descriptor and no memory."""

    def __init__(
        self,
        folder: ArrayFolder,
        file: str,
        shape: tuple[int, ...],
        kind: np.dtype[Value],
        offset: int,
        every: int = 1,
    ) -> None:
        self.folder = folder
        self.file = file
        self.kind = kind
        self.offset = offset
        self.every = every
        self.row_shape = shape[1:]
        self.count = -(-shape[0] // every)
        self.row_bytes = int(np.prod(self.row_shape)) * kind.itemsize

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.count, *self.row_shape)

    def __len__(self) -> int:
        return self.count

    @overload
    def __getitem__(self, index: NDArray[np.int64], /) -> NDArray[Value]: ...

    @overload
    def __getitem__(self, index: int, /) -> NDArray[Value]: ...

    def __getitem__(self, index: int | NDArray[np.int64], /) -> NDArray[Value]:
        places = np.atleast_1d(np.asarray(index, np.int64)).tolist()
        rows = np.empty((len(places), *self.row_shape), self.kind)
        try:
            with self.folder.open(self.file) as stream:
                for row, place in zip(rows.reshape(len(places), -1), places, strict=True):
                    begin = self.offset + place * self.every * self.row_bytes
                    if os.preadv(stream.fileno(), [row.view(np.uint8).data], begin) != self.row_bytes:
                        raise DamagedError(
                            f"{self.folder.path(self.file)} ends before row {place}; prepare its segment again"
                        )
        except OSError as problem:
            raise TrainerError(
                f"cannot read {self.folder.path(self.file)}: {problem}; check the file and its permissions"
            ) from problem
        return rows[0] if isinstance(index, int) else rows


def _digest_of(line: str) -> tuple[str, str]:
    """The name of a file and its digest. Both name files, so nothing else may be in their place."""
    digest, name = line.split("  ", 1)
    if not is_sha256(digest) or "/" in name:
        raise ValueError(f"{SUMS_FILE} has the line {line!r}, which is no SHA-256 of a file in the folder")
    return name, digest


class ArrayFolder:
    """A folder that `FolderWriter` wrote."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            self.sums = self.read(SUMS_FILE).decode()
            self.digests = dict(_digest_of(line) for line in self.sums.splitlines())
            self.meta: dict[str, Any] = json.loads(self.read(META_FILE))
        except (OSError, ValueError) as problem:
            raise DamagedError(f"{self} cannot be read: {problem}") from None

    def __str__(self) -> str:
        return str(self.folder)

    def path(self, name: str) -> str:
        """What errors call one of its files."""
        return f"{self}/{name}"

    def open(self, name: str) -> FileIO:
        """One of its files, unbuffered."""
        return FileIO(self.folder / name)

    def read(self, name: str) -> bytes:
        """The content of a small file."""
        with self.open(name) as stream:
            return stream.readall()

    def beginning(self, name: str) -> tuple[bytes, int]:
        """The first bytes of a file, and its length."""
        with self.open(name) as stream:
            return stream.read(HEADER_BYTES), os.fstat(stream.fileno()).st_size

    @property
    def digest(self) -> str:
        """The digest of all arrays."""
        return hashlib.sha256(self.sums.encode()).hexdigest()

    def array(self, name: str, kind: type[Value], every: int = 1) -> StoredArray[Value]:
        """An array whose file is as long as its header says."""
        try:
            return self._described(name, kind, every, *self.beginning(f"{name}.npy"))
        except OSError as problem:
            raise self._unreadable(name, problem) from None

    def load(self, name: str, kind: type[Value], every: int = 1) -> NDArray[Value]:
        """An array in memory."""
        try:
            with self.open(f"{name}.npy") as stream:
                size = os.fstat(stream.fileno()).st_size
                stored = self._described(name, kind, 1, stream.read(HEADER_BYTES), size)
                stream.seek(0)
                values = np.fromfile(stream, stored.kind, offset=stored.offset)
        except OSError as problem:
            raise self._unreadable(name, problem) from None
        return values.reshape(stored.shape)[::every]

    def _described(self, name: str, kind: type[Value], every: int, first: bytes, size: int) -> StoredArray[Value]:
        """An array, from the first bytes of its file and the length of it."""
        header = BytesIO(first)
        try:
            np.lib.format.read_magic(header)
            shape, _, found = np.lib.format.read_array_header_1_0(header)
        except ValueError as problem:
            raise self._unreadable(name, problem) from None
        file = f"{name}.npy"
        expected = header.tell() + int(np.prod(shape)) * found.itemsize
        if found != np.dtype(kind) or size != expected:
            raise DamagedError(
                f"{self.path(file)} has {size} bytes of {found} instead of {expected} of {np.dtype(kind)}"
            )
        return StoredArray(self, file, shape, np.dtype(kind), header.tell(), every)

    def _unreadable(self, name: str, problem: Exception) -> DamagedError:
        return DamagedError(f"{self.path(name)}.npy cannot be read: {problem}")

    def check(self) -> None:
        """Compares every file with its digest."""
        for name, expected in self.digests.items():
            try:
                with self.open(name) as stream:
                    found = hashlib.file_digest(stream, "sha256").hexdigest()
            except OSError as problem:
                raise DamagedError(f"{self.path(name)} cannot be read: {problem}") from None
            if found != expected:
                raise DamagedError(f"{self.path(name)} has the digest {found[:16]} instead of {expected[:16]}")


def digest_in(folder: Path) -> str:
    """The digest of all arrays in a folder of which nothing else is wanted."""
    try:
        return hashlib.sha256((folder / SUMS_FILE).read_bytes()).hexdigest()
    except OSError as problem:
        raise DamagedError(f"{folder} cannot be read: {problem}") from None


def _header(shape: tuple[int, ...], kind: np.dtype[Any]) -> bytes:
    stream = BytesIO()
    described = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, described)
    return stream.getvalue()
