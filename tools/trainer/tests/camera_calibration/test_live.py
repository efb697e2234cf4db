"""The live stream: frames are taken where the board is held still at a new place."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from embodied_depth_trainer.camera_calibration import live
from embodied_depth_trainer.camera_calibration.arrays import Image
from embodied_depth_trainer.camera_calibration.live import Collection, collect
from embodied_depth_trainer.camera_calibration.views import Observations, View
from embodied_depth_trainer.errors import TrainerError

from .cli import run
from .synthetic import CHARUCO_BOARD, WIDE, images, observations

NOTHING = np.zeros((480, 640), np.uint8)


class FakeCapture:
    """Delivers frames; None is a frame that is missing, and Ctrl-C comes at the end if it is wanted."""

    def __init__(self, frames: list[Image | None], interrupted: bool = False) -> None:
        self.frames = list(frames)
        self.interrupted = interrupted

    def read(self) -> tuple[bool, Image | None]:
        if not self.frames:
            if self.interrupted:
                raise KeyboardInterrupt
            return False, None
        frame = self.frames.pop(0)
        return frame is not None, frame


class FakeDetector:
    """Finds in a frame the view whose number is in its first pixel, moved by the second pixel."""

    def __init__(self, seen: Observations) -> None:
        self.seen = seen

    def find(self, name: str, picture: Image) -> View:
        mine = self.seen.view == int(picture[0, 0])
        shift = float(picture[0, 1])
        return View(name, self.seen.corner[mine], self.seen.points_mm[mine], self.seen.pixels[mine] + shift)


def frame(view: int, shift: int = 0) -> Image:
    picture = NOTHING.copy()
    picture[0, :2] = (view, shift)
    return picture


def test_a_view_is_taken_once_when_the_board_is_still_and_not_while_it_moves() -> None:
    said: list[str] = []
    moving: list[Image | None] = [frame(0, shift) for shift in range(0, 60, 6)]
    still: list[Image | None] = [frame(1)] * 12
    missing: list[Image | None] = [None, None]
    elsewhere: list[Image | None] = [frame(2)] * 5
    capture = FakeCapture([*moving, *still, *missing, *elsewhere], interrupted=True)
    found = collect(capture, FakeDetector(observations(WIDE, views=3)), said.append)
    assert len(found.views) == 2
    assert "1 views" in said[1]
    assert "no corners yet at" in said[1]
    assert "tilt the board more" in said[1]
    assert "Ctrl-C" in said[-1]


def test_the_stream_ends_by_itself_with_enough_views() -> None:
    count = 60
    frames: list[Image | None] = [frame(view) for view in range(count) for _ in range(live.STILL_FRAMES + 1)]
    capture = FakeCapture(frames)
    said: list[str] = []
    found = collect(capture, FakeDetector(observations(WIDE, views=count)), said.append)
    assert len(found.views) >= live.ENOUGH_VIEWS
    assert capture.frames, "the stream would have had more"
    assert said[-1].endswith("enough")


def test_the_same_place_is_not_taken_again_but_the_same_place_with_another_tilt_is() -> None:
    seen = observations(WIDE, views=1)
    board = seen.points_mm[:, :2] - seen.points_mm[:, :2].mean(axis=0)

    def tilted(by: float) -> View:
        scale = 1 / (1 + by * board[:, :1] / 100)
        return View("", seen.corner, seen.points_mm, 320 + 2 * board * scale)

    collection = Collection(640, 480)
    taken = [collection.offer(tilted(by)) for by in (0.0, 0.3) for _ in range(8)]
    assert sum(taken) == 2
    assert collection.tilted == 1


def test_a_camera_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match="the camera delivers no frames"):
        collect(FakeCapture([]), FakeDetector(observations(WIDE, views=1)), print)
    with pytest.raises(TrainerError, match="cannot open"):
        run("camera", tmp_path / "no-camera", "--out", tmp_path / "lens.toml")


def test_a_video_file_is_read_to_its_end_and_its_views_are_kept(tmp_path: Path) -> None:
    video = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    assert writer.isOpened()
    for picture in images(WIDE, CHARUCO_BOARD, 2):
        for _ in range(live.STILL_FRAMES + 1):
            writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    with pytest.raises(TrainerError, match="2 views with the board are too few"):
        run("camera", video, "--out", tmp_path / "lens.toml", "--keep", tmp_path / "kept")
    assert sorted(file.name for file in (tmp_path / "kept").iterdir()) == ["view_001.png", "view_002.png"]
    assert not (tmp_path / "lens.toml").exists()
