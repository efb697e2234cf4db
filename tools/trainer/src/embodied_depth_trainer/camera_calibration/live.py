"""Views of a board from a live camera: takes a frame when the board is held still at a new place.

The lines on the terminal say which part of the image still lacks corners, so that a person at the camera knows where to
hold the board next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from embodied_depth_trainer.camera_calibration import coverage
from embodied_depth_trainer.camera_calibration.arrays import Floats, Image, Indices
from embodied_depth_trainer.camera_calibration.detect import Detector
from embodied_depth_trainer.camera_calibration.fit import LEAST_CORNERS
from embodied_depth_trainer.camera_calibration.images import Found
from embodied_depth_trainer.camera_calibration.opencv import opencv
from embodied_depth_trainer.camera_calibration.views import View
from embodied_depth_trainer.errors import TrainerError

# The board is still if its corners move by less than this between frames, as a share of the width. At 30 Hz and an
# exposure of half a frame, 0.15 % of 640 pixels blurs a corner by half a pixel, less than the lens does.
STILL = 0.0015
# For this many frames in a row.
STILL_FRAMES = 3
# A place is new if the board's corners are this far from those of every view, as a share of the width.
NEW_PLACE = 0.06
# A view is tilted if opposite sides of the board differ by this much.
TILTED = 0.12
ENOUGH_TILTED = 8
ENOUGH_VIEWS = 30
# More views hardly help, and the parts that still lack corners may be out of reach.
MOST_VIEWS = 80
# A camera that delivers no frame this often is gone. At the end of a video file the first miss is the end.
MISSES = 30


class Capture(Protocol):
    """What this module needs of `cv2.VideoCapture`."""

    def read(self) -> tuple[bool, Image | None]: ...


@dataclass
class Collection:
    """The views so far, and what still lacks."""

    width: int
    height: int
    views: list[View] = field(default_factory=list)
    shapes: list[Floats] = field(default_factory=list)
    tilted: int = 0
    last: View | None = None
    still: int = 0

    def offer(self, view: View) -> bool:
        """Takes the view if the board is held still at a new place."""
        self.still = self.still + 1 if self._is_still(view) else 0
        self.last = view
        if self.still < STILL_FRAMES or len(view.corners) < LEAST_CORNERS:
            return False
        shape = _quad(view)
        if any(np.linalg.norm(shape - other, axis=1).mean() < NEW_PLACE * self.width for other in self.shapes):
            return False
        self.views.append(view)
        self.shapes.append(shape)
        self.tilted += _foreshortening(shape) > TILTED
        return True

    def _is_still(self, view: View) -> bool:
        if self.last is None:
            return False
        _, ours, theirs = np.intersect1d(view.corners, self.last.corners, return_indices=True)
        if len(ours) < LEAST_CORNERS // 2:
            return False
        moved = np.linalg.norm(view.pixels[ours] - self.last.pixels[theirs], axis=1)
        return float(np.median(moved)) < STILL * self.width

    @property
    def covered(self) -> float:
        return coverage.share(self._counts())

    def _counts(self) -> Indices:
        pixels = np.concatenate([view.pixels for view in self.views]) if self.views else np.zeros((0, 2))
        return coverage.counts(pixels, self.width, self.height)

    @property
    def enough(self) -> bool:
        good = len(self.views) >= ENOUGH_VIEWS and self.covered >= 0.95 and self.tilted >= ENOUGH_TILTED
        return good or len(self.views) >= MOST_VIEWS

    def status(self) -> str:
        """One line: how much there is, and what to do next."""
        wanted = []
        lacking = coverage.missing(self._counts())
        if lacking:
            wanted.append(f"no corners yet at {lacking}")
        if self.tilted < ENOUGH_TILTED:
            wanted.append("tilt the board more")
        if not wanted and len(self.views) < ENOUGH_VIEWS:
            wanted.append("more places and distances")
        head = f"{len(self.views)} views, {self.covered:.0%} of the image, {self.tilted} tilted"
        return f"{head}; {'; '.join(wanted) if wanted else 'enough'}"


def _quad(view: View) -> Floats:
    """The four corners of what is seen of the board, by a homography, so that views of different corners compare."""
    low = view.points_mm[:, :2].min(axis=0)
    high = view.points_mm[:, :2].max(axis=0)
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    matrix, _ = opencv().findHomography(view.points_mm[:, :2], view.pixels)
    if matrix is None:
        return np.repeat(view.pixels.mean(axis=0)[None], 4, axis=0)
    flat = np.column_stack([corners, np.ones(4)]) @ np.asarray(matrix).T
    return np.asarray(flat[:, :2] / flat[:, 2:])


def _foreshortening(quad: Floats) -> float:
    """By how much opposite sides differ, as a share of their mean; the larger of both pairs."""
    sides = np.linalg.norm(quad - np.roll(quad, -1, axis=0), axis=1)
    return float(max(abs(sides[a] - sides[b]) / max(sides[a] + sides[b], 1e-9) * 2 for a, b in ((0, 2), (1, 3))))


def collect(
    capture: Capture,
    detector: Detector,
    say: Callable[[str], None],
    keep: Path | None = None,
    misses: int = MISSES,
) -> Found:
    """Takes views until there are enough, the stream ends, or Ctrl-C."""
    collection: Collection | None = None
    try:
        for number, picture in enumerate(_frames(capture, misses)):
            if collection is None:
                collection = Collection(picture.shape[1], picture.shape[0])
                say("Hold the board still at many places and tilts; Ctrl-C ends and calibrates.")
            elif picture.shape[:2] != (collection.height, collection.width):
                raise TrainerError("the stream has changed its size; start again")
            if not collection.offer(detector.find(f"frame {number}", picture)):
                continue
            say(collection.status())
            if keep is not None:
                _save(keep / f"view_{len(collection.views):03d}.png", picture)
            if collection.enough:
                break
    except KeyboardInterrupt:
        say("Ctrl-C: calibrating with what there is.")
    if collection is None:
        raise TrainerError("the camera delivers no frames; check its path, and that no other program uses it")
    return Found(collection.views, (collection.width, collection.height), [])


def _frames(capture: Capture, misses: int) -> Iterator[Image]:
    """Grey frames of the stream until it has ended."""
    missed = 0
    while missed < misses:
        delivered, picture = capture.read()
        if not delivered or picture is None:
            missed += 1
            continue
        missed = 0
        yield picture if picture.ndim == 2 else np.asarray(opencv().cvtColor(picture, opencv().COLOR_BGR2GRAY))


def _save(file: Path, picture: Image) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    if not opencv().imwrite(str(file), picture):
        raise TrainerError(f"cannot write {file}; check --keep")


def open_stream(source: str, width: int | None, height: int | None) -> tuple[Capture, int]:
    """The device or video file, and after how many missing frames it has ended."""
    cv2 = opencv()
    is_file = Path(source).is_file()
    if is_file:
        capture = cv2.VideoCapture(source)
    else:
        device = int(source) if source.isdecimal() else source
        capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
        if width is not None and height is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
    if not capture.isOpened():
        raise TrainerError(
            f"cannot open {source}; give a camera such as /dev/video0 that no other program uses, or a video"
        )
    return capture, 1 if is_file else MISSES
