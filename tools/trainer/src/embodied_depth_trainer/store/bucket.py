"""Objects of an object store: `s3://BUCKET/PREFIX`, `gs://BUCKET/PREFIX`, `az://CONTAINER/PREFIX`, or `file:///FOLDER`.

Credentials and addresses come from the environment, as for `pull-buffer`: both use the same library (`object_store`).
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from embodied_depth_trainer.errors import TrainerError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

# Names in one page of a listing, the most that S3 returns.
PAGE = 1000
# Bytes of one request. What is in memory of a segment; a broken request costs one of them again.
PIECE = 8 << 20
# Attempts for each piece, besides the library's own for errors of the server.
TRIES = 3


# How long a training waits for an object store that does not answer, and the pauses between its attempts.
PATIENCE_S = 600.0
FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 5.0


# Set when the program ends: it waits for its threads, which are not to wait for an object store.
ENDING = threading.Event()


class ReplacedError(TrainerError):
    """An object is not the one that was listed."""


class UnreachableError(TrainerError):
    """The object store does not answer, or refuses the request."""

    def __init__(self, what: str, problem: Exception) -> None:
        # The library adds the fields of its errors after the first line.
        self.reason = f"cannot read {what}: {next(iter(str(problem).splitlines()), type(problem).__name__)}"
        super().__init__(
            f"{self.reason}; check address and credentials (AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, "
            "GOOGLE_APPLICATION_CREDENTIALS ...), and run the same command again: what is done is kept"
        )


@dataclass(frozen=True)
class StoredObject:
    """One version of an object, as it was listed."""

    path: str
    """Below the URL of the listing."""
    bytes: int
    modified_ns: int
    etag: str | None
    """Identifies the version, where the store has such a thing."""


def list_objects(url: str) -> Iterator[StoredObject]:
    """All objects below a URL, page by page."""
    try:
        for page in _store(url).list(chunk_size=PAGE):
            for found in page:
                modified_ns = int(found["last_modified"].timestamp() * 1e9)
                yield StoredObject(found["path"], found["size"], modified_ns, found["e_tag"])
    except Exception as problem:
        raise _unreadable(url, problem) from None


def download(url: str, listed: StoredObject, file: Path) -> None:
    """Writes the version of the object that was listed to a file."""
    with file.open("wb") as stream:
        for begin, end in _pieces(listed):
            stream.write(read_part(url, listed, begin, end))


def read_object(url: str, listed: StoredObject) -> bytes:
    """The version of a small object that was listed."""
    return b"".join(read_part(url, listed, begin, end) for begin, end in _pieces(listed))


def patient_pieces(url: str, listed: StoredObject) -> Iterator[bytes]:
    """The version of the object that was listed, piece by piece, with pauses while the object store does not answer: a
    training of days outlasts its restart."""
    return (_patiently(partial(read_part, url, listed, begin, end)) for begin, end in _pieces(listed))


@contextmanager
def patience() -> Iterator[None]:
    """The pauses of downloads end when the context ends by an error."""
    ENDING.clear()
    try:
        yield
    except BaseException:
        ENDING.set()
        raise


def _pieces(listed: StoredObject) -> Iterator[tuple[int, int]]:
    return ((begin, min(begin + PIECE, listed.bytes)) for begin in range(0, listed.bytes, PIECE))


def _patiently(read: Callable[[], bytes]) -> bytes:
    end, pause = time.monotonic() + PATIENCE_S, FIRST_PAUSE_S
    while True:
        try:
            return read()
        except UnreachableError as problem:
            if time.monotonic() > end or ENDING.is_set():
                raise
            print(f"{problem.reason}; trying again", file=sys.stderr)
        ENDING.wait(pause)
        pause = min(2 * pause, LONGEST_PAUSE_S)


def delete_objects(url: str, objects: Sequence[StoredObject]) -> None:
    """Removes objects that were listed below a URL. A bucket with versions keeps the earlier ones."""
    try:
        _store(url).delete([found.path for found in objects])
    except Exception as problem:
        raise _unreadable(url, problem) from None


def read_part(url: str, listed: StoredObject, begin: int, end: int) -> bytes:
    """Bytes of the version of the object that was listed."""
    if begin == end:
        # No range of HTTP is empty.
        return b""
    from obstore.exceptions import PreconditionError

    for attempt in range(1, TRIES + 1):
        try:
            answer = _store(url).get(listed.path, options={"range": (begin, end), "if_match": listed.etag})
            # Not every store compares the tag.
            if (answer.meta["size"], answer.meta["e_tag"]) != (listed.bytes, listed.etag):
                raise ReplacedError(f"{url}/{listed.path} was replaced while it was read")
            return bytes(answer.bytes())
        except (PreconditionError, FileNotFoundError):
            raise ReplacedError(f"{url}/{listed.path} was replaced or removed while it was read") from None
        except ReplacedError:
            raise
        except Exception as problem:
            if attempt == TRIES:
                raise _unreadable(f"{url}/{listed.path}", problem) from None
    raise AssertionError


@lru_cache(maxsize=8)
def _store(url: str) -> ObjectStore:
    try:
        from obstore.store import from_url
    except ImportError:
        raise TrainerError(
            f"{url} is in an object store, which needs the package obstore; run `pip install obstore`"
        ) from None
    return from_url(url, retry_config={"max_retries": TRIES - 1})


def _unreadable(what: str, problem: Exception) -> TrainerError:
    return problem if isinstance(problem, TrainerError) else UnreachableError(what, problem)
