"""Finds the corners of a board in a picture."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats, Image, Indices
from embodied_depth_trainer.camera_calibration.board import APRILTAG_BORDER_BITS, CHARUCO, Board
from embodied_depth_trainer.camera_calibration.opencv import opencv
from embodied_depth_trainer.camera_calibration.views import View

# The window of the refinement may cover this share of the way to the next edge; what lies beyond would pull the corner.
WINDOW_SHARE = 0.8
WINDOW_PX = (2, 11)
# Refinement ends after this many steps, or when the corner moves by less, in pixels.
REFINE_STEPS = 40
REFINE_PX = 0.001
# A corner that the refinement moves further has jumped to another edge, in pixels and in windows. Kalibr takes 1.2
# pixels.
FURTHEST_PX = 1.5
FURTHEST = 0.3
# Images up to this wide are enlarged twice before markers are searched: a bit of a marker needs about four pixels. Of
# the tags in synthetic images of 640 pixels, that and the settings below find 250 of 414 instead of 72.
ENLARGED_WIDTH = 1600
ENLARGED = 2
# Windows of the threshold between black and white, in pixels: OpenCV's end at 23, less than a near tag's border.
THRESHOLD_WINDOWS = (5, 45, 8)
# Pixels per bit of a marker when it is read; OpenCV's 4 lose bits that lie askew.
PIXELS_PER_BIT = 8
# Nearer to the edge of the picture, the refinement's window would be cut off.
EDGE_PX = 3.0


class Detector(Protocol):
    """Finds one board."""

    def find(self, name: str, picture: Image) -> View:
        """The corners in a grey picture, perhaps none."""


def detector(board: Board) -> Detector:
    return CharucoDetector(board) if board.kind == CHARUCO else AprilGridDetector(board)


class CharucoDetector:
    """OpenCV's detector: corners between markers that it has read."""

    def __init__(self, board: Board) -> None:
        self.corners_mm = board.corners_mm()
        self.clearance = (board.square_mm - board.marker_side_mm) / 2 / board.square_mm
        self.opencv = opencv()
        self.detector: Any = self.opencv.aruco.CharucoDetector(board.charuco())
        self.detector.setDetectorParameters(_parameters(self.opencv, 1))

    def find(self, name: str, picture: Image) -> View:
        large, factor = _enlarged(self.opencv, picture)
        found, numbers, _, _ = self.detector.detectBoard(large)
        if found is None or numbers is None or len(numbers) < 4:
            return _view(name, self.corners_mm, np.zeros(0, np.int64), np.zeros((0, 2)))
        pixels = _reduced(np.asarray(found, np.float64).reshape(-1, 2), factor)
        corners = np.asarray(numbers, np.int64).ravel()
        gaps = [np.sort(np.linalg.norm(pixels - pixel, axis=1))[1] for pixel in pixels]
        # The next edges are those of the markers, which begin beside each corner.
        refined = _refined(self.opencv, picture, pixels, self.clearance * np.array(gaps))
        return _view(name, self.corners_mm, corners, refined, picture)


class AprilGridDetector:
    """Tags by OpenCV's detector; which corner is which follows from where the tags are."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.corners_mm = board.corners_mm()
        self.opencv = opencv()
        parameters = _parameters(self.opencv, APRILTAG_BORDER_BITS)
        self.detector: Any = self.opencv.aruco.ArucoDetector(board.marker_dictionary(), parameters)

    def find(self, name: str, picture: Image) -> View:
        large, factor = _enlarged(self.opencv, picture)
        found, numbers, _ = self.detector.detectMarkers(large)
        tags = [] if numbers is None else [int(number) for number in np.ravel(numbers)]
        # A tag that is seen twice is none of this board, or a reflection.
        single = [index for index, tag in enumerate(tags) if tag < self.board.markers and tags.count(tag) == 1]
        if len(single) < 2:
            return _view(name, self.corners_mm, np.zeros(0, np.int64), np.zeros((0, 2)))
        corners = np.concatenate([self.board.tag_corners(tags[index]) for index in single])
        quads = np.stack([_reduced(np.asarray(found[index], np.float64).reshape(4, 2), factor) for index in single])
        sides = np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).min(axis=1)
        pixels = self._ordered(corners, quads).reshape(-1, 2)
        # The next edges are those of the next black square, and of the white bits inside of the tag's border.
        clearance = min(self.board.spacing, APRILTAG_BORDER_BITS / (6 + 2 * APRILTAG_BORDER_BITS))
        refined = _refined(self.opencv, picture, pixels, np.repeat(clearance * sides, 4))
        return _view(name, self.corners_mm, corners, refined, picture)

    def _ordered(self, corners: Indices, quads: Floats) -> Floats:
        """Each tag's corners counter-clockwise from the bottom left.

        OpenCV lists them clockwise from the marker's own first corner. Which one that is depends on how the print
        rotates the tags; the order under which all corners lie on one plane is right.
        """
        backwards = quads[:, ::-1]
        orders = [np.roll(backwards, shift, axis=1) for shift in range(4)]
        flat = self.corners_mm[corners, :2]
        return min(orders, key=lambda order: _misfit(flat, order.reshape(-1, 2)))


def _parameters(cv2: Any, border_bits: int) -> Any:  # noqa: ANN401
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax, step = THRESHOLD_WINDOWS
    parameters.adaptiveThreshWinSizeStep = step
    parameters.perspectiveRemovePixelPerCell = PIXELS_PER_BIT
    return parameters


def _enlarged(cv2: Any, picture: Image) -> tuple[Image, int]:  # noqa: ANN401
    if picture.shape[1] > ENLARGED_WIDTH:
        return picture, 1
    return np.asarray(cv2.resize(picture, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)), ENLARGED


def _reduced(pixels: Floats, factor: int) -> Floats:
    """Pixels of the enlarged picture as those of the picture; the edges of both coincide."""
    return (pixels + 0.5) / factor - 0.5


def _misfit(flat: Floats, pixels: Floats) -> float:
    """Root mean square distance from the best affine map."""
    columns = np.column_stack([flat, np.ones(len(flat))])
    return float(np.sqrt(np.mean((columns @ np.linalg.lstsq(columns, pixels, rcond=None)[0] - pixels) ** 2)))


def _refined(cv2: Any, picture: Image, pixels: Floats, clearances: Floats) -> Floats:  # noqa: ANN401
    """Corners to a fraction of a pixel; NaN where the refinement left its window. `clearances` are the distances to the
    next edge."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, REFINE_STEPS, REFINE_PX)
    windows = np.clip((WINDOW_SHARE * clearances).astype(int), *WINDOW_PX)
    refined = pixels.astype(np.float32)
    for window in np.unique(windows):
        chosen = windows == window
        part = refined[chosen].reshape(-1, 1, 2).copy()
        # The picture is of bytes, and OpenCV changes `part`.
        cv2.cornerSubPix(picture, part, (int(window), int(window)), (-1, -1), criteria)
        refined[chosen] = part[:, 0]
    moved = np.linalg.norm(refined - pixels, axis=1)
    found = refined.astype(np.float64)
    found[moved > np.maximum(FURTHEST_PX, FURTHEST * windows)] = np.nan
    return found


def _view(name: str, corners_mm: Floats, corners: Indices, pixels: Floats, picture: Image | None = None) -> View:
    """The corners that were refined and are far enough from the edge, by their number."""
    good = np.isfinite(pixels).all(axis=1)
    if picture is not None:
        limits = np.array(picture.shape[1::-1]) - 1 - EDGE_PX
        with np.errstate(invalid="ignore"):
            good &= ((pixels >= EDGE_PX) & (pixels <= limits)).all(axis=1)
    order = np.flatnonzero(good)[np.argsort(corners[good])]
    return View(name, corners[order], corners_mm[corners[order]], pixels[order])
