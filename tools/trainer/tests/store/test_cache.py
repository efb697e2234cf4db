"""A cache holds complete files that are what their names say, and never more bytes than it may."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from io import FileIO
from pathlib import Path

import pytest

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.cache import Cache, DigestError, locked

# A process that begins a download, says so, and waits in it.
DOWNLOADS = """
import sys, time
from pathlib import Path
from embodied_depth_trainer.store.cache import Cache

def slow():
    yield b"half "
    print("begun", flush=True)
    time.sleep(600)

Cache(Path(sys.argv[1]), 100).open(sys.argv[2], 10, slow)
"""


def content(number: int, size: int = 40) -> bytes:
    return bytes([number]) * size


def digest_of(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def read(cache: Cache, data: bytes, downloads: list[bytes] | None = None) -> bytes:
    """The file through the cache; notes that it was downloaded."""

    def download() -> Iterator[bytes]:
        if downloads is not None:
            downloads.append(data)
        yield data[: len(data) // 2]
        yield data[len(data) // 2 :]

    with cache.open(digest_of(data), len(data), download) as stream:
        return stream.readall()


def bytes_in(cache: Cache) -> int:
    return sum(file.stat().st_size for file in cache.files.iterdir())


def test_what_was_not_used_for_longest_is_deleted_first(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    downloads: list[bytes] = []
    for number in (1, 2, 1, 3, 1, 2):
        assert read(cache, content(number), downloads) == content(number)
        for file in cache.files.iterdir():
            # The clock of a file system may have steps of milliseconds.
            state = file.stat()
            os.utime(file, ns=(0, state.st_mtime_ns - 10**9))
    assert downloads == [content(number) for number in (1, 2, 3, 2)]
    assert {file.name for file in cache.files.iterdir()} == {digest_of(content(number)) for number in (1, 2)}


def test_many_threads_never_fill_it_beyond_its_bytes_and_each_reads_what_it_wants(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    most = 0

    def used(number: int) -> bool:
        nonlocal most
        data = content(number % 7)

        def download() -> Iterator[bytes]:
            nonlocal most
            for at in range(len(data)):
                # No other thread changes the folder while it is measured.
                with locked(tmp_path / "lock"):
                    most = max(most, bytes_in(cache))
                yield data[at : at + 1]

        with cache.open(digest_of(data), len(data), download) as stream:
            return stream.readall() == data

    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(used, range(200)))
    assert 40 < most <= 100
    assert not list(cache.files.glob("*.partial"))


def test_threads_that_want_the_same_file_download_it_once(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    downloads: list[bytes] = []
    together = threading.Barrier(8)

    def wanted(_: int) -> bytes:
        together.wait()
        return read(cache, content(1), downloads)

    with ThreadPoolExecutor(8) as threads:
        assert set(threads.map(wanted, range(8))) == {content(1)}
    assert len(downloads) == 1


def test_a_file_that_was_completed_since_it_was_not_found_is_not_downloaded_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = Cache(tmp_path, 100)
    find = cache.find

    def found_once_completed(digest: str) -> FileIO | None:
        monkeypatch.setattr(cache, "find", find)
        missing = find(digest)
        read(Cache(tmp_path, 100), content(1))
        return missing

    monkeypatch.setattr(cache, "find", found_once_completed)
    downloads: list[bytes] = []
    assert read(cache, content(1), downloads) == content(1)
    assert not downloads
    assert [file.name for file in cache.files.iterdir()] == [digest_of(content(1))]


def test_a_file_that_is_deleted_stays_readable_where_it_is_open(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 50)
    with cache.open(digest_of(content(1)), 40, lambda: [content(1)]) as stream:
        read(cache, content(2))
        assert [file.name for file in cache.files.iterdir()] == [digest_of(content(2))]
        assert stream.readall() == content(1)


def test_what_a_killed_process_has_half_downloaded_is_neither_used_nor_kept(tmp_path: Path) -> None:
    for wanted_again in (True, False):
        name = digest_of(content(1, 10))
        process = subprocess.Popen([sys.executable, "-c", DOWNLOADS, str(tmp_path), name], stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        partial = tmp_path / "files" / f"{name}.partial"
        assert partial.stat().st_size == 10
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        assert partial.exists()
        cache = Cache(tmp_path, 100)
        if wanted_again:
            assert read(cache, content(1, 10)) == content(1, 10)
            (tmp_path / "files" / name).unlink()
        else:
            # Its bytes are needed for another file.
            assert read(cache, content(2, 95)) == content(2, 95)
        assert not partial.exists()


def test_a_large_file_that_a_killed_process_has_half_downloaded_is_downloaded_again(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    data = content(1, 60)
    (cache.files / f"{digest_of(data)}.partial").write_bytes(bytes(60))
    assert read(cache, data) == data
    assert bytes_in(cache) == 60


def test_a_number_of_bytes_that_is_wrong_or_was_half_written_lets_nothing_in_beyond_the_limit(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    for number, text in enumerate((b"", b"8", b"x\n", b"1000000\n")):
        (tmp_path / "lock").write_bytes(text)
        assert read(cache, content(number)) == content(number)
        assert bytes_in(cache) <= 100


@pytest.mark.parametrize("digest", ["../outside", "/etc/hostname", "A" * 64, ""])
def test_what_is_no_digest_names_no_file(tmp_path: Path, digest: str) -> None:
    outside = tmp_path / "outside"
    outside.write_bytes(b"of another program")
    cache = Cache(tmp_path / "cache", 100)
    for use in (cache.check, cache.find):
        with pytest.raises(ValueError, match="no SHA-256"):
            use(digest)
    assert outside.read_bytes() == b"of another program"


def test_a_download_with_another_digest_or_one_that_fails_leaves_nothing(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    with pytest.raises(DigestError, match=digest_of(content(2))):
        cache.open(digest_of(content(1)), 40, lambda: [content(2)])

    def broken() -> Iterator[bytes]:
        yield b"half"
        raise TrainerError("the link broke")

    with pytest.raises(TrainerError, match="the link broke"):
        cache.open(digest_of(content(1)), 40, broken)
    assert not list(cache.files.iterdir())
    assert read(cache, content(1)) == content(1)


def test_a_file_that_was_changed_on_the_disk_is_deleted_by_a_check(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    for number in (1, 2):
        read(cache, content(number))
    (cache.files / digest_of(content(1))).write_bytes(content(3))
    for number in (1, 2, 3):
        cache.check(digest_of(content(number)))
    assert [file.name for file in cache.files.iterdir()] == [digest_of(content(2))]


def test_a_file_that_is_larger_than_the_cache_is_refused_with_the_bytes_that_it_needs(tmp_path: Path) -> None:
    cache = Cache(tmp_path, 100)
    read(cache, content(1))
    with pytest.raises(TrainerError, match="at least --cache-bytes 101"):
        read(cache, content(2, 101))
    assert bytes_in(cache) == 40
