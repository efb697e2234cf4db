"""Coarse depth from one or two past frames as in the paper, and networks that are trained with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.past_frames import PastFrames, triangulate, with_past_coarse
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.training import checkpoint as checkpoints

from ..recordings import straight, write_segment
from ..rooms import camera, render, room

Planes = NDArray[np.float64]


def exact_flow(depth_m: Planes, t_past_target: Planes, size: tuple[int, int]) -> Planes:
    view = camera(*size)
    v, u = np.mgrid[: size[0], : size[1]].astype(float)
    points = np.stack([(u - view.cx) / view.fx * depth_m, (v - view.cy) / view.fy * depth_m, depth_m], -1)
    x, y, z = np.moveaxis(points @ t_past_target[:3, :3].T + t_past_target[:3, 3], -1, 0)
    return np.stack([view.fx * x / z + view.cx - u, view.fy * y / z + view.cy - v], -1)


def pose(x_m: float, z_m: float, yaw: float) -> Planes:
    """`t_past_target` of a camera that moved and rotated by this much."""
    found = np.eye(4)
    found[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    found[:3, 3] = x_m, 0, z_m
    return found


def test_exact_flow_gives_exact_depth_from_one_frame_and_from_two() -> None:
    size = (32, 96)
    depth = 1 + 3 * np.random.default_rng(2).random(size)
    poses = [pose(0.12, 0.1, 0.05), pose(0.25, 0.2, 0.1)]
    flows = [exact_flow(depth, t, size) for t in poses]
    for count in (1, 2):
        found, confidence = triangulate(camera(*size), flows[:count], poses[:count])
        valid = found > 0
        assert valid.mean() > 0.75
        assert np.abs(found / np.where(valid, depth, 1) - valid).max() < 1e-6
        assert ((confidence > 0) == valid).all()


def test_a_second_frame_with_more_baseline_makes_depth_more_certain_and_closer_to_the_truth() -> None:
    size = (32, 96)
    random = np.random.default_rng(3)
    depth = np.full(size, 3.0)
    poses = [pose(0.1, 0.0, 0.0), pose(0.2, 0.0, 0.0)]
    flows = [exact_flow(depth, t, size) + random.normal(0, 0.5, (*size, 2)) for t in poses]
    one, confidence_of_one = triangulate(camera(*size), flows[:1], poses[:1])
    two, confidence_of_two = triangulate(camera(*size), flows, poses)

    def right(found: Planes) -> float:
        return float((np.maximum(found, depth) < 1.25 * np.minimum(found, depth)).mean())

    assert right(two) > right(one) + 0.05
    assert confidence_of_two.mean() > confidence_of_one.mean() + 0.05


def test_a_rotation_on_the_spot_gives_no_depth() -> None:
    size = (32, 96)
    rotated = pose(0.0, 0.0, 0.1)
    found, confidence = triangulate(camera(*size), [exact_flow(np.full(size, 2.0), rotated, size)], [rotated])
    assert not found.any()
    assert not confidence.any()


def test_only_past_frames_of_the_same_run_that_moved_are_taken() -> None:
    frames = room(14)
    assert PastFrames(2, 5).of(frames, 12) == [7, 2]
    assert PastFrames(1, 5).of(frames, 12) == [7]
    assert PastFrames(2, 5).of(frames, 7) == [2]
    assert PastFrames(2, 5).of(frames, 4) == []
    cut = replace(frames, run=(np.arange(14) >= 6).astype(np.int32))
    assert PastFrames(2, 5).of(cut, 12) == [7]
    still = replace(frames, t_world_camera=np.tile(np.eye(4), (14, 1, 1)))
    assert PastFrames(2, 5).of(still, 12) == []
    for count, gap in ((0, 5), (3, 5), (1, 0)):
        with pytest.raises(TrainerError, match="give 1 or 2"):
            PastFrames(count, gap)


@pytest.fixture(scope="module")
def textured() -> Frames:
    """A camera that moves sideways and ahead through the room, without coarse depth."""
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, 0, 3] = 0.03 * np.arange(12)
    poses[:, 2, 3] = 0.02 * np.arange(12)
    view = camera(96, 192)
    rendered = [render(view, pose) for pose in poses]
    truth = np.stack([(1000 * depth).round().astype(np.uint16) for _, depth in rendered])
    times = np.arange(12, dtype=np.int64) * 100_000_000
    return Frames(view, np.stack([rgb for rgb, _ in rendered]), poses, times, np.zeros(12, np.int32), truth)


@pytest.mark.parametrize("count", [1, 2])
def test_frames_of_a_room_give_its_depth(textured: Frames, count: int) -> None:
    pytest.importorskip("cv2")
    found = with_past_coarse(textured, PastFrames(count)).coarse
    assert found is not None
    assert textured.truth_mm is not None
    assert not found[:5].any()
    depth = found[11, 0].astype(float)
    truth = textured.truth_mm[11].astype(float)
    confident = found[11, 1] > 0.7 * 65535
    assert confident.mean() > 0.5
    right = np.maximum(depth, truth) < 1.25 * np.minimum(depth, truth)
    assert right[confident].mean() > 0.9


@pytest.mark.parametrize("network", ["edn_r18", "edn_r18_concat"])
def test_edn_trains_with_past_frames_and_its_export_records_it(
    network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cv2")
    run = tmp_path / "run"
    run.mkdir()
    write_segment(run / "recording_0000.mcap", room(24), straight(24), truth=True)
    recording = ["--recording", str(run)]
    for count in ("1", "2"):
        past = ["--past-frames", count, "--past-gap", "3"]
        assert main(["prepare", str(run), *past, "--no-labels", "--out", str(tmp_path / f"store{count}")]) == 0
    train = ["train", "--network", network, "--batch", "2", "--out", str(tmp_path / "out"), "--steps", "1"]
    one, two = (["--store", str(tmp_path / name)] for name in ("store1", "store2"))
    assert main([*train, *two]) == 0
    saved = checkpoints.load(tmp_path / "out/checkpoint.pt")
    assert saved.past_frames == PastFrames(2, 3)
    # Other coarse depth means another training.
    assert main([*train, *one]) == 1
    assert "past_frames" in capsys.readouterr().err
    assert main([*train, *one, *two]) == 1
    assert "different past frames" in capsys.readouterr().err
    out = tmp_path / "edn.onnx"
    assert main(["export", "--checkpoint", str(tmp_path / "out/checkpoint.pt"), "--out", str(out)]) == 0
    metadata = {entry.key: entry.value for entry in onnx.load(str(out)).metadata_props}
    assert metadata["kind"] == "rgb+coarse"
    assert metadata["coarse_from"] == "2 past frames, 3 apart"
    assert float(metadata["parity_max_abs"]) < 1e-4
    # It is evaluated with the coarse depth that it was trained with.
    assert main(["evaluate", *recording, "--checkpoint", str(tmp_path / "out/checkpoint.pt")]) == 0
    assert "coarse" in capsys.readouterr().out
    assert main(["evaluate", "--views", "views", "--checkpoint", str(tmp_path / "out/checkpoint.pt")]) == 1
    assert "have no past frames" in capsys.readouterr().err
