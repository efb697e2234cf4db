"""Folders of arrays appear completely or not at all, and damage is found."""

from __future__ import annotations

import errno
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError, FolderWriter

ROWS = np.arange(7 * 6, dtype=np.uint16).reshape(7, 2, 3)


def written(folder: Path) -> ArrayFolder:
    writer = FolderWriter(folder, len(ROWS))
    writer.append("planes", ROWS[:4])
    assert not folder.exists()
    writer.append("planes", ROWS[4:])
    writer.append("pose", ROWS[:, 0].astype(np.float64))
    writer.finish({"name": "one"})
    return ArrayFolder(folder)


def test_rows_are_read_as_they_were_written(tmp_path: Path) -> None:
    folder = written(tmp_path / "one")
    planes = folder.array("planes", np.uint16)
    assert planes.shape == ROWS.shape
    index: NDArray[np.int64] = np.array([6, 0, 0, 3])
    assert np.array_equal(planes[index], ROWS[index])
    assert np.array_equal(planes[2], ROWS[2])
    third = folder.array("planes", np.uint16, every=3)
    assert np.array_equal(third[np.arange(len(third))], ROWS[::3])
    assert np.array_equal(folder.load("pose", np.float64, 2), ROWS[::2, 0])
    assert folder.meta == {"name": "one"}


def test_numpy_maps_the_arrays_and_sha256sum_checks_them(tmp_path: Path) -> None:
    folder = written(tmp_path / "one").folder
    assert np.array_equal(np.load(folder / "planes.npy", mmap_mode="r"), ROWS)
    subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=folder, check=True, capture_output=True)


def test_the_digest_depends_on_the_content_only(tmp_path: Path) -> None:
    one = written(tmp_path / "one")
    other = written(tmp_path / "elsewhere" / "two")
    assert one.digest == other.digest
    writer = FolderWriter(tmp_path / "three", 1)
    writer.append("planes", ROWS[:1])
    writer.finish({"name": "one"})
    assert ArrayFolder(tmp_path / "three").digest != one.digest


@pytest.mark.parametrize("file", ["planes.npy", "pose.npy", "meta.json"])
def test_every_flipped_bit_is_found(tmp_path: Path, file: str) -> None:
    folder = written(tmp_path / "one")
    content = (folder.folder / file).read_bytes()
    for place in range(0, len(content), 13):
        changed = bytearray(content)
        changed[place] ^= 1
        (folder.folder / file).write_bytes(changed)
        with pytest.raises(DamagedError, match=f"{file} has the digest"):
            folder.check()
    (folder.folder / file).write_bytes(content)
    folder.check()


def test_an_array_that_is_cut_is_named_when_it_is_opened_and_when_it_is_read(tmp_path: Path) -> None:
    folder = written(tmp_path / "one")
    planes = folder.array("planes", np.uint16)
    file = folder.folder / "planes.npy"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(DamagedError, match=r"planes\.npy has \d+ bytes of uint16 instead of"):
        folder.array("planes", np.uint16)
    assert np.array_equal(planes[5], ROWS[5])
    with pytest.raises(DamagedError, match=r"planes\.npy ends before row 6"):
        planes[6]


def test_a_folder_of_which_files_are_missing_is_damaged(tmp_path: Path) -> None:
    folder = written(tmp_path / "one").folder
    (folder / "SHA256SUMS").unlink()
    with pytest.raises(DamagedError, match="SHA256SUMS"):
        ArrayFolder(folder)


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(TrainerError, match=r"cannot write .*one: .*No space left.*free some space"):
        written(tmp_path / "one")
    assert list(tmp_path.iterdir()) == []


def test_of_two_writers_of_the_same_folder_the_second_changes_nothing(tmp_path: Path) -> None:
    first = written(tmp_path / "one")
    before = {file.name: file.stat().st_mtime_ns for file in first.folder.iterdir()}
    writer = FolderWriter(first.folder, len(ROWS))
    writer.append("planes", ROWS)
    writer.finish({"name": "one"})
    assert {file.name: file.stat().st_mtime_ns for file in first.folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
