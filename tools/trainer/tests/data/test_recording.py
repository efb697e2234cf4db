"""Recordings and dumps become frames, and errors name what is wrong with them."""

from __future__ import annotations

import os
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from embodied_depth_trainer.data.coarse_depth import read_dataset_dump, with_coarse
from embodied_depth_trainer.data.frames import Intrinsics, join
from embodied_depth_trainer.data.recording import read_recording
from embodied_depth_trainer.errors import TrainerError

from ..recordings import dump_of, straight, write_segment
from ..rooms import room


def test_images_poses_and_ground_truth_are_read_over_all_segments(tmp_path: Path) -> None:
    frames = room(6)
    write_segment(tmp_path / "recording_0001.mcap", replace(frames, rgb=255 - frames.rgb), straight(6), 1, truth=True)
    write_segment(tmp_path / "recording_0000.mcap", frames, straight(6), truth=True)
    (tmp_path / "map.png").write_bytes(b"")
    found, damage = read_recording(tmp_path)
    assert not damage.segments
    assert found.camera == frames.camera
    assert np.array_equal(found.rgb, np.concatenate([frames.rgb, 255 - frames.rgb]))
    assert found.truth_mm is not None
    assert frames.truth_mm is not None
    assert np.array_equal(found.truth_mm[:6], frames.truth_mm)
    # The camera rendered along the base's x: right is -y, down is -z.
    expected = np.array([[0, 0, 1, 0.1 + 0.05 * 3], [-1, 0, 0, 0], [0, -1, 0, 0.8], [0, 0, 0, 1.0]])
    assert np.allclose(found.t_world_camera[3], expected)


def test_a_rotation_of_the_base_rotates_the_camera(tmp_path: Path) -> None:
    write_segment(tmp_path / "a.mcap", room(1), [{"x_m": 1.0, "y_m": 2.0, "yaw_rad": np.pi / 2}])
    found, _ = read_recording(tmp_path / "a.mcap")
    assert np.allclose(found.t_world_camera[0, :3, 3], [1.0, 2.1, 0.8])
    assert np.allclose(found.t_world_camera[0, :3, 2], [0, 1, 0])


def test_the_localized_pose_replaces_that_of_the_wheels(tmp_path: Path) -> None:
    localized = straight(4, step_m=0.06)
    write_segment(tmp_path / "a.mcap", room(4), straight(4), localized=localized)
    found, _ = read_recording(tmp_path / "a.mcap")
    # The camera is mounted 0.1 m ahead of the base.
    assert np.allclose(found.t_world_camera[:, 0, 3], [0.1 + pose["x_m"] for pose in localized])


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
def test_a_cut_segment_gives_its_complete_chunks_and_is_named(tmp_path: Path, share: float) -> None:
    frames = room(20)
    write_segment(tmp_path / "recording_0000.mcap", frames, straight(20))
    cut = tmp_path / "recording_0001.mcap"
    write_segment(cut, frames, straight(20), 1)
    whole = cut.read_bytes()
    cut.write_bytes(whole[: int(share * len(whole))])
    found, damage = read_recording(tmp_path)
    assert 20 <= len(found) <= 40
    assert list(damage.segments) == ["recording_0001.mcap"]
    assert "1 damaged segments" in str(damage)
    assert np.array_equal(found.rgb[20:], frames.rgb[: len(found) - 20])


def chunk_ends(segment: bytes) -> list[int]:
    """Offsets at which each chunk is complete: a record is an opcode, a length and that many bytes (MCAP
    specification, Records)."""
    at = 8
    ends = []
    while at + 9 <= len(segment):
        opcode, length = struct.unpack_from("<BQ", segment, at)
        at += 9 + length
        if opcode == 0x06:
            ends.append(at)
    return ends


def test_a_segment_cut_anywhere_gives_every_complete_chunk(tmp_path: Path) -> None:
    frames = room(20)
    cut = tmp_path / "recording_0000.mcap"
    write_segment(cut, frames, straight(20))
    whole = cut.read_bytes()
    ends = chunk_ends(whole)
    assert len(ends) >= 4
    # At many places in the last two chunks, and at random places before them.
    random = np.random.default_rng(6)
    cuts = [*ends[:-1], *range(ends[-3], ends[-1], 101), *random.integers(ends[0], ends[-3], 50).tolist()]
    counts: dict[int, int] = {}
    for at in cuts:
        cut.write_bytes(whole[:at])
        found, damage = read_recording(tmp_path)
        assert list(damage.segments) == ["recording_0000.mcap"], at
        assert np.array_equal(found.rgb, frames.rgb[: len(found)]), at
        complete = sum(end <= at for end in ends)
        assert len(found) == counts.setdefault(complete, len(found)), at
    assert sorted(counts.values()) == [counts[complete] for complete in sorted(counts)]
    assert len(set(counts.values())) == len(ends) - 1


def test_a_flipped_bit_is_never_trained_on(tmp_path: Path) -> None:
    frames = room(20)
    write_segment(tmp_path / "recording_0000.mcap", frames, straight(20))
    damaged = tmp_path / "recording_0001.mcap"
    write_segment(damaged, frames, straight(20), 1)
    whole = bytearray(damaged.read_bytes())
    for at in range(100, len(whole) // 2, len(whole) // 23):
        flipped = bytearray(whole)
        flipped[at] ^= 0x10
        damaged.write_bytes(flipped)
        try:
            found, _ = read_recording(tmp_path)
        except TrainerError:
            # A flipped bit in the header changes the camera.
            continue
        rest = len(found) - 20
        assert rest <= 20
        assert any(np.array_equal(found.rgb[20:], frames.rgb[start : start + rest]) for start in range(21))


def test_errors_name_the_unusable_recording_and_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match="does not exist; give the --out directory"):
        read_recording(tmp_path / "nowhere")
    with pytest.raises(TrainerError, match="holds no recording_NNNN"):
        read_recording(tmp_path)
    frames = room(3)
    write_segment(tmp_path / "recording_0000.mcap", frames, [*straight(2), {"x_m": 0.1, "y_m": "7ff8000000000000"}])
    with pytest.raises(TrainerError, match="tick 2 has no pose in `wheel`"):
        read_recording(tmp_path)
    write_segment(tmp_path / "recording_0000.mcap", frames, straight(3))
    other = replace(frames, camera=replace(frames.camera, fx=50.0))
    write_segment(tmp_path / "recording_0001.mcap", other, straight(3), 1)
    with pytest.raises(TrainerError, match=r"recording_0001.*fx=50.*its own directory"):
        read_recording(tmp_path)
    (tmp_path / "recording_0000.mcap").write_bytes(b"no mcap")
    (tmp_path / "recording_0001.mcap").write_bytes(b"")
    with pytest.raises(TrainerError, match=r"2 damaged segments.*recording_0000"):
        read_recording(tmp_path)


def test_coarse_depth_is_matched_by_time_and_must_be_complete(tmp_path: Path) -> None:
    frames = room(8)
    dump_of(frames, tmp_path / "coarse")
    bare = replace(frames, coarse=None)
    assert np.array_equal(with_coarse(bare, tmp_path / "coarse").coarse, frames.coarse)  # type: ignore[arg-type]
    with pytest.raises(TrainerError, match="lacks 8 of 8"):
        with_coarse(replace(bare, time_ns=bare.time_ns + 1), tmp_path / "coarse")
    with pytest.raises(TrainerError, match="perceive --recording"):
        with_coarse(bare, tmp_path)
    with pytest.raises(TrainerError, match="give --recording RUN --coarse"):
        read_dataset_dump(tmp_path / "coarse")


def test_reduced_images_keep_their_rays() -> None:
    frames = room(2, (64, 192))
    half = frames.reduced_to((32, 96))
    # The left edge of the image, and so the ray through it, stays where it is.
    before = frames.camera
    after = half.camera
    assert (-0.5 - before.cx) / before.fx == pytest.approx((-0.5 - after.cx) / after.fx)
    assert half.rgb.shape == (2, 32, 96, 3)
    assert abs(float(half.rgb.mean()) - float(frames.rgb.mean())) < 0.5
    assert half.coarse is not None
    assert frames.coarse is not None
    assert np.isin(half.coarse[0, 0], frames.coarse[0, 0]).all()
    with pytest.raises(TrainerError, match="cannot become 30x96"):
        frames.reduced_to((30, 96))


def test_runs_are_joined_but_not_mixed() -> None:
    one = room(3)
    two = room(4, seed=1)
    both = join([one, two])
    assert both.run.tolist() == [0, 0, 0, 1, 1, 1, 1]
    assert both.coarse is not None
    assert join([one, replace(two, coarse=None)]).coarse is None
    with pytest.raises(TrainerError, match="different cameras"):
        join([one, replace(two, camera=Intrinsics(96, 32, 1.0, 1.0, 0.0, 0.0))])


def firmware_host() -> Path:
    repository = Path(__file__).resolve().parents[4]
    target = Path(os.environ.get("CARGO_TARGET_DIR", repository / "target"))
    for profile in ("release", "debug"):
        if (file := target / profile / "firmware-host").is_file():
            return file
    pytest.skip("no firmware-host; build it with `cargo build --release -p firmware-host`")


def test_the_robots_own_recording_and_dump_are_read(tmp_path: Path) -> None:
    robot = firmware_host()
    run = tmp_path / "run"
    explore = [
        "explore",
        "--scene",
        "builtin:apartment?seed=1",
        "--depth",
        "truth",
        "--frames",
        "40",
        "--policy",
        "forward",
    ]
    subprocess.run([robot, *explore, "--out", run], check=True, capture_output=True)
    dump: list[str | Path] = ["perceive", "--recording", run, "--out", tmp_path / "out", "--dump", tmp_path / "coarse"]
    subprocess.run([robot, *dump], check=True, capture_output=True)
    frames, damage = read_recording(run)
    frames = with_coarse(frames, tmp_path / "coarse")
    assert not damage.segments
    assert len(frames) == 40
    assert frames.truth_mm is not None
    assert frames.coarse is not None
    coarse = frames.coarse[-1, 0].astype(float)
    truth = frames.truth_mm[-1].astype(float)
    both = (coarse > 0) & (truth > 0)
    assert both.mean() > 0.3
    assert (np.maximum(coarse, truth) < 1.25 * np.minimum(coarse, truth))[both].mean() > 0.8
