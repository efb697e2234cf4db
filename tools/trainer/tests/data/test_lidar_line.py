"""The LiDAR's line in the image, and the loss along it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.batches import lidar_lines, make_batch
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.lidar_line import APART_NS, Scan, line
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.data.recording import read_recording, read_segment
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.losses.lidar import lidar_error
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..recordings import straight, write_segment
from ..rooms import camera, render, room
from ..stores import record, without_coarse

# From the scanner (x ahead, y left, z up) to a camera that rendered ahead 0.4 m above it.
AHEAD = np.array([[0, -1, 0, 0], [0, 0, -1, 0.4], [1, 0, 0, 0], [0, 0, 0, 1.0]])
INCREMENT = np.pi / 720
PERIOD_NS = 25_000_000


def scan_of(ranges: NDArray[np.float64], time_ns: int = 0) -> Scan:
    """A scan from the right to the left, of half a circle or less, with the middle beam ahead."""
    return Scan(time_ns, -INCREMENT * (len(ranges) // 2), INCREMENT, 0.1, 30.0, PERIOD_NS, ranges)


def scan_of_the_room(pose: NDArray[np.float64]) -> Scan:
    """The scan of a scanner 0.4 m below the camera in the room of `rooms.py`, in closed form."""
    angles = INCREMENT * np.arange(-360, 361)
    in_camera = np.stack([-np.sin(angles), np.zeros(721), np.cos(angles)], 1)
    beams = (in_camera @ pose[:3, :3].T)[:, [0, 2]]
    with np.errstate(divide="ignore"):
        walls = (np.sign(beams) * np.array([2.5, 3.5]) - pose[[0, 2], 3]) / beams
    return scan_of(walls.min(1))


def with_lines(frames: Frames) -> Frames:
    lines = [line(frames.camera, AHEAD, scan_of_the_room(pose)) for pose in frames.t_world_camera]
    return replace(frames, lidar=np.stack(lines))


def test_a_wall_straight_ahead_is_a_straight_line_at_its_depth() -> None:
    view = camera(64, 192)
    angles = INCREMENT * np.arange(-180, 181)
    row, millimetres = line(view, AHEAD, scan_of(2.0 / np.cos(angles)))
    valid = millimetres > 0
    # The scan covers 90 degrees on both sides; 361 beams over 192 columns hit every column.
    assert valid.all()
    # cy + fy 0.4 / 2.0.
    assert (row == round(31.5 + 96 * 0.2)).all()
    assert (millimetres == 2000).all()


def test_the_line_lies_on_the_pixels_that_show_the_walls_at_their_depth() -> None:
    view = camera(64, 192)
    frames = room(8, (64, 192), seed=3)
    for pose in frames.t_world_camera:
        row, millimetres = line(view, AHEAD, scan_of_the_room(pose)).astype(int)
        columns = np.flatnonzero(millimetres)
        assert len(columns) > 180
        _, truth = render(view, pose)
        ratio = millimetres[columns] / 1000 / truth[row[columns], columns]
        # An error of half a pixel where a wall is seen at a low angle.
        assert np.abs(np.log(ratio)).max() < 0.05
        assert np.abs(np.log(ratio)).mean() < 0.006


def test_near_hits_appear_low_in_the_image_and_then_below_it() -> None:
    view = camera(64, 192)
    # The last row is 31.5 pixels below the middle: at 96 * 0.4 / 31.5 = 1.22 m.
    for distance, rows in ((8.0, [36]), (2.0, [51]), (1.3, [61]), (1.1, [])):
        row, millimetres = line(view, AHEAD, scan_of(np.full(3, distance)))
        assert sorted(set(row[millimetres > 0].tolist())) == rows


def test_beams_without_return_and_errors_give_no_depth() -> None:
    view = camera(64, 192)
    for nothing in (np.inf, -np.inf, np.nan, 0.0, -2.0, 0.05, 30.5):
        assert not line(view, AHEAD, scan_of(np.full(361, nothing))).any()
    ranges = np.full(361, np.inf)
    ranges[180] = 3.0
    _, millimetres = line(view, AHEAD, scan_of(ranges))
    assert np.count_nonzero(millimetres) == 1


def test_of_two_hits_in_one_column_the_nearer_counts() -> None:
    view = camera(32, 32)
    ranges = np.full(721, np.inf)
    ranges[[362, 363]] = 5.0, 3.0
    row, millimetres = line(view, AHEAD, scan_of(ranges))
    (column,) = np.flatnonzero(millimetres)
    assert (row[column], millimetres[column]) == (round(15.5 + 16 * 0.4 / 3), 3000)


def test_the_loss_is_the_log_distance_with_gradients_on_the_line_only() -> None:
    depth = torch.full((2, 1, 4, 3), 2.0, requires_grad=True)
    lines = torch.tensor([[[1.0, 0.0, 3.0], [4.0, 0.0, 2.0]], [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    loss = lidar_error(depth, lines)
    assert float(loss.detach()) == pytest.approx((np.log(2.0) + 0.0 + np.log(2.0)) / 3)
    loss.backward()  # type: ignore[no-untyped-call]
    assert depth.grad is not None
    expected = torch.zeros(2, 1, 4, 3)
    # d |ln d - ln z| / dd = sign / d, over three pixels.
    expected[0, 0, 1, 0] = -1 / 6
    expected[1, 0, 0, 1] = 1 / 6
    # At a perfect fit the gradient of the absolute value is 0.
    assert torch.allclose(depth.grad, expected)


def test_the_gradient_equals_finite_differences() -> None:
    generator = torch.Generator().manual_seed(1)
    depth = (1 + 3 * torch.rand(2, 1, 5, 6, generator=generator, dtype=torch.float64)).requires_grad_()
    rows = torch.randint(5, (2, 1, 6), generator=generator).double()
    lines = torch.cat([rows, 5 * torch.rand(2, 1, 6, generator=generator, dtype=torch.float64)], 1)
    lines[0, 1, 2] = 0
    assert torch.autograd.gradcheck(lambda d: lidar_error(d, lines), (depth,))


def test_frames_without_hits_have_zero_loss() -> None:
    depth = torch.full((1, 1, 4, 3), 2.0, requires_grad=True)
    loss = lidar_error(depth, torch.zeros(1, 2, 3))
    loss.backward()  # type: ignore[no-untyped-call]
    assert float(loss.detach()) == 0
    assert depth.grad is not None
    assert not depth.grad.any()


def test_reduced_images_keep_the_nearest_hit_on_the_right_row() -> None:
    frames = with_lines(room(4, (64, 192)))
    small = frames.reduced(2)
    assert small.lidar is not None
    assert small.lidar.shape == (4, 2, 96)
    truth = small.truth_mm
    assert truth is not None
    for index in range(4):
        row, millimetres = small.lidar[index].astype(int)
        columns = np.flatnonzero(millimetres)
        assert np.abs(np.log(millimetres[columns] / truth[index][row[columns], columns])).mean() < 0.02
    nothing = replace(frames, lidar=np.zeros_like(frames.lidar)).reduced(2)
    assert nothing.lidar is not None
    assert not nothing.lidar.any()


def test_a_crop_has_its_part_of_the_line() -> None:
    frames = with_lines(room(8, (64, 192)))
    assert frames.lidar is not None
    index = np.arange(3)
    batch = make_batch(frames, index, index[:, None] + 1, (0.1, 20.0), None).cropped(32, 64)
    assert batch.lidar is not None
    assert torch.equal(batch.lidar, lidar_lines(frames.lidar, index)[..., 32:96])


def test_training_on_the_line_alone_reduces_the_metric_error(tmp_path: Path) -> None:
    frames = with_lines(room(40))
    settings = Settings(
        batch=4, learning_rate=2e-3, photometric_weight=0.0, coarse_weight=0.0, uncertainty_weight=0.0, lidar_weight=1.0
    )
    blind = replace(frames, coarse=np.zeros((40, 2, 32, 96), np.uint16))
    trainer = Trainer(blind, pairs_by_baseline(blind, PairRule()), settings)
    first = float(trainer.loss(trainer.batch(0)).detach())
    train(trainer, 60, tmp_path)
    assert float(trainer.loss(trainer.batch(0)).detach()) < 0.5 * first


def scans_of(frames: Frames, apart_ns: int = 0) -> list[Scan]:
    return [
        replace(scan_of_the_room(pose), time_ns=int(time) + apart_ns)
        for pose, time in zip(frames.t_world_camera, frames.time_ns, strict=True)
    ]


def test_recorded_scans_are_read_on_request_and_projected_by_the_mounts(tmp_path: Path) -> None:
    frames = room(5, (64, 192))
    write_segment(tmp_path / "a.mcap", frames, straight(5), scans=scans_of(frames))
    without, _ = read_recording(tmp_path / "a.mcap")
    assert without.lidar is None
    found = read_segment(tmp_path / "a.mcap").frames
    assert found.lidar is not None
    # The recording's camera is 0.1 m ahead of the scanner and 0.4 m above.
    mount = AHEAD.copy()
    mount[2, 3] = -0.1
    expected = [line(frames.camera, mount, scan) for scan in scans_of(frames)]
    assert np.array_equal(found.lidar, np.stack(expected))


def test_a_scan_is_placed_at_the_pose_of_its_own_time(tmp_path: Path) -> None:
    # A wall 2 m ahead of the camera. The scan was taken 0.3 m further back, 2.4 m from the wall.
    frames = room(1, (64, 192))
    ranges = 2.4 / np.cos(INCREMENT * np.arange(-180, 181))
    scan = replace(scan_of(ranges), time_ns=int(frames.time_ns[0]))
    behind = [{"x_m": -0.3, "y_m": 0.0, "yaw_rad": 0.0}]
    write_segment(tmp_path / "a.mcap", frames, straight(1), scans=[scan], scan_odom=behind)
    found = read_segment(tmp_path / "a.mcap").frames
    assert found.lidar is not None
    row, millimetres = found.lidar[0]
    valid = millimetres > 0
    assert valid.any()
    # The recording's camera is 0.1 m ahead of the scanner and 0.4 m above.
    assert (millimetres[valid] == 2000).all()
    assert (row[valid] == round(31.5 + 96 * 0.4 / 2.0)).all()


def test_a_scan_that_is_too_old_or_new_is_not_used(tmp_path: Path) -> None:
    frames = room(3, (64, 192))
    late = scans_of(frames, APART_NS[0] - PERIOD_NS // 2 + 1)
    write_segment(tmp_path / "a.mcap", frames, straight(3), scans=[late[0], *scans_of(frames)[1:]])
    found = read_segment(tmp_path / "a.mcap").frames
    assert found.lidar is not None
    assert not found.lidar[0].any()
    assert found.lidar[1:, 1].any(axis=1).all()


def test_the_newest_whole_scan_of_a_slow_scanner_belongs_to_the_frame() -> None:
    # An LD06: the middle of the scan is 150 ms before the frame at most.
    scan = replace(scan_of(np.ones(3)), period_ns=100_000_000)
    assert scan.belongs_to(200_000_000)
    assert not scan.belongs_to(250_000_001)


def test_a_scan_that_contradicts_its_tick_ends_the_segment(tmp_path: Path) -> None:
    frames = room(4, (64, 192))
    scans = scans_of(frames)
    scans[2] = replace(scans[2], ranges_m=scans[2].ranges_m[:5])
    write_segment(tmp_path / "recording_0000.mcap", frames, straight(4), scans=scans, beams=721)
    found = read_segment(tmp_path / "recording_0000.mcap")
    assert len(found.frames) == 2
    assert found.damage is not None
    assert "a scan with 5 beams" in found.damage


def test_lidar_loss_without_scans_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = room(24)
    pairs = pairs_by_baseline(frames, PairRule())
    with pytest.raises(TrainerError, match="needs LiDAR scans"):
        Trainer(frames, pairs, Settings(lidar_weight=0.1))
    with pytest.raises(TrainerError, match="omit --lidar-weight"):
        Trainer(with_lines(frames), pairs, Settings(network="manydepth_r18", lidar_weight=0.1))
    record(tmp_path / "run", frames, [24])
    store = without_coarse(tmp_path / "run", tmp_path / "store")
    command = ["train", "--store", str(store.folder), "--network", "monodepth2_r18", "--steps", "1"]
    assert main([*command, "--lidar-weight", "0.1", "--out", str(tmp_path / "out")]) == 1
    assert "has a LiDAR scan from about its time" in capsys.readouterr().err
