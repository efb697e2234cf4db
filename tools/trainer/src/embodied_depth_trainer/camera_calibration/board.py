"""The two kinds of printed boards: where their corners are, and their black shapes.

ChArUco is OpenCV's board: corners are numbered row by row from the top left, y points down. The AprilGrid is Kalibr's:
tags of the family 36h11 with a black border of two bits, numbered row by row from the bottom left; y points up, and
small black squares between the tags make every tag's corner the saddle of a chess board. Its corners are numbered in
rows that run across all tags, as Kalibr's `GridCalibrationTargetAprilgrid` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Flags, Floats, Indices
from embodied_depth_trainer.camera_calibration.opencv import opencv
from embodied_depth_trainer.camera_calibration.outline import outline
from embodied_depth_trainer.errors import TrainerError

CHARUCO = "charuco"
APRILGRID = "aprilgrid"
KINDS = (CHARUCO, APRILGRID)
# A board of 8 x 6 has 24 markers, so that a dictionary of 100 suffices; 5 x 5 bits are read from farther away than
# 6 x 6.
DICTIONARY = "DICT_5X5_100"
APRILTAG = "DICT_APRILTAG_36h11"
# A marker of this share of its square leaves a white border of an eighth of the square, which its detector needs.
MARKER_SHARE = 0.75
# Kalibr's default spacing between tags, as a share of a tag.
SPACING = 0.3
APRILTAG_BORDER_BITS = 2


@dataclass(frozen=True)
class Board:
    """A board as it was printed."""

    kind: str
    columns: int
    """Squares of a ChArUco board, or tags of an AprilGrid."""
    rows: int
    square_mm: float
    """Side of a square, or of a tag."""
    marker_mm: float = 0.0
    """Side of a ChArUco board's marker; 0 is the usual share of the square."""
    dictionary: str = DICTIONARY
    spacing: float = SPACING
    """Space between the tags of an AprilGrid, as a share of a tag."""
    legacy: bool = False
    """Whether the ChArUco board was made by OpenCV before 4.6: boards with an even number of rows differ."""

    def __post_init__(self) -> None:
        if self.square_mm <= 0 or not np.isfinite(self.square_mm):
            raise TrainerError(f"--square-mm {self.square_mm:g} is not a length; measure a square of the print")
        least = 3 if self.kind == CHARUCO else 2
        if min(self.columns, self.rows) < least:
            raise TrainerError(
                f"--squares {self.columns}x{self.rows} is too small; a board needs at least {least}x{least}"
            )
        if self.kind == CHARUCO and not 0 < self.marker_side_mm < self.square_mm:
            raise TrainerError(
                f"--marker-mm {self.marker_mm:g} is not below the square's {self.square_mm:g} mm; measure the black "
                "border of a marker"
            )
        if self.kind == APRILGRID and not 0 < self.spacing < 1:
            raise TrainerError(f"--spacing {self.spacing:g} must be between 0 and 1: the gap divided by the tag")
        markers = self.markers
        available = len(self.marker_dictionary().bytesList)
        if markers > available:
            raise TrainerError(
                f"a board of {self.columns}x{self.rows} has {markers} markers and {self.dictionary} has {available}; "
                "give fewer squares or a larger --dictionary"
            )

    @property
    def marker_side_mm(self) -> float:
        return self.marker_mm or round(MARKER_SHARE * self.square_mm, 1)

    @property
    def markers(self) -> int:
        count = self.columns * self.rows
        return count if self.kind == APRILGRID else count // 2

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of what is black."""
        if self.kind == CHARUCO:
            return self.columns * self.square_mm, self.rows * self.square_mm
        step = (1 + self.spacing) * self.square_mm
        gap = self.spacing * self.square_mm
        return self.columns * step + gap, self.rows * step + gap

    def describe(self) -> str:
        if self.kind == CHARUCO:
            return (
                f"ChArUco, {self.columns} x {self.rows} squares of {self.square_mm:g} mm, markers of "
                f"{self.marker_side_mm:g} mm, {self.dictionary}"
            )
        return (
            f"AprilGrid, {self.columns} x {self.rows} tags of {self.square_mm:g} mm, gaps of "
            f"{self.spacing * self.square_mm:g} mm (spacing {self.spacing:g}), tag36h11"
        )

    def marker_dictionary(self) -> Any:  # noqa: ANN401
        aruco = opencv().aruco
        name = APRILTAG if self.kind == APRILGRID else self.dictionary
        if not name.startswith("DICT_") or not hasattr(aruco, name):
            raise TrainerError(f"--dictionary {name} is none of OpenCV's, such as {DICTIONARY} or DICT_4X4_50")
        return aruco.getPredefinedDictionary(getattr(aruco, name))

    def charuco(self) -> Any:  # noqa: ANN401
        """OpenCV's board, in millimetres."""
        size = (self.columns, self.rows)
        board = opencv().aruco.CharucoBoard(size, self.square_mm, self.marker_side_mm, self.marker_dictionary())
        board.setLegacyPattern(self.legacy)
        return board

    def corners_mm(self) -> Floats:
        """All corners [n, 3] by their number."""
        if self.kind == CHARUCO:
            x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
            flat = self.square_mm * np.column_stack([x.ravel(), y.ravel()])
        else:
            x, y = np.meshgrid(self._tag_edges(self.columns), self._tag_edges(self.rows))
            flat = np.column_stack([x.ravel(), y.ravel()])
        return np.column_stack([flat, np.zeros(len(flat))])

    def _tag_edges(self, count: int) -> Floats:
        index = np.arange(2 * count)
        return np.asarray(self.square_mm * ((index // 2) * (1 + self.spacing) + index % 2), np.float64)

    def tag_corners(self, tag: int) -> Indices:
        """Numbers of an AprilGrid tag's corners, counter-clockwise from the bottom left."""
        row, column = divmod(tag, self.columns)
        across = 2 * self.columns
        first = 2 * row * across + 2 * column
        return np.array([first, first + 1, first + across + 1, first + across], np.int64)

    def shapes_mm(self) -> list[Floats]:
        """Outlines of what is black, from the top left with y down; what two outlines enclose is white again."""
        return self._charuco_shapes() if self.kind == CHARUCO else self._aprilgrid_shapes()

    def _charuco_shapes(self) -> list[Floats]:
        board = self.charuco()
        markers = [np.asarray(corners, np.float64)[:, :2] for corners in board.getObjPoints()]
        taken = {tuple((corners.mean(axis=0) // self.square_mm).astype(int)) for corners in markers}
        shapes = [
            _rectangle(column * self.square_mm, row * self.square_mm, self.square_mm)
            for row in range(self.rows)
            for column in range(self.columns)
            if (column, row) not in taken
        ]
        for number, corners in zip(np.ravel(board.getIds()), markers, strict=True):
            shapes += _placed(self._bits(int(number)), corners.min(axis=0), self.marker_side_mm)
        return shapes

    def _aprilgrid_shapes(self) -> list[Floats]:
        gap = self.spacing * self.square_mm
        step = self.square_mm + gap
        shapes = [
            _rectangle(column * step, row * step, gap)
            for row in range(self.rows + 1)
            for column in range(self.columns + 1)
        ]
        for tag in range(self.markers):
            row, column = divmod(tag, self.columns)
            place = np.array([gap + column * step, gap + (self.rows - 1 - row) * step])
            # Kalibr prints what OpenCV calls the same tag rotated by 180 degrees.
            shapes += _placed(self._bits(tag, APRILTAG_BORDER_BITS)[::-1, ::-1], place, self.square_mm)
        return shapes

    def _bits(self, number: int, border: int = 1) -> Flags:
        """Which bits of a marker are black, with its border."""
        side = self.marker_dictionary().markerSize + 2 * border
        picture = opencv().aruco.generateImageMarker(self.marker_dictionary(), number, side, borderBits=border)
        return np.asarray(picture == 0, np.bool_)


def _rectangle(left: float, top: float, side: float) -> Floats:
    return np.array([[left, top], [left + side, top], [left + side, top + side], [left, top + side]])


def _placed(black: Flags, place: Floats, side_mm: float) -> list[Floats]:
    """Outlines of the black bits of a marker, at its place on the board."""
    return [place + shape * (side_mm / len(black)) for shape in outline(black)]
