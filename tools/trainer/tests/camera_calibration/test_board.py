"""The print file of a board: its scale, and that detectors find every corner where the board says."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from embodied_depth_trainer.camera_calibration.board import APRILGRID, CHARUCO, Board
from embodied_depth_trainer.camera_calibration.detect import detector
from embodied_depth_trainer.camera_calibration.sheet import place
from embodied_depth_trainer.errors import TrainerError

from .cli import run
from .synthetic import APRILGRID_BOARD, CHARUCO_BOARD, Texture, texture

# The first code of the family 36h11, as Kalibr's list of codes has it.
TAG_0 = 0xD5D628584


def bits(printed: Texture, board: Board, left_mm: float, top_mm: float) -> str:
    """Black (0) and white (1) in the middle of the 6 x 6 bits of a tag, row by row."""
    bit_mm = board.square_mm / 10
    centres = (np.arange(6) + 2.5) * bit_mm
    columns = ((left_mm + centres) * printed.px_per_mm).astype(int)
    rows = ((top_mm + centres) * printed.px_per_mm).astype(int)
    return "".join("1" if printed.grey[row, column] > 127 else "0" for row in rows for column in columns)


@pytest.mark.parametrize("board", [CHARUCO_BOARD, APRILGRID_BOARD, Board(CHARUCO, 7, 6, 25.0, legacy=True)])
def test_every_corner_of_the_print_is_found_at_its_place_in_millimetres(board: Board) -> None:
    printed = texture(board)
    view = detector(board).find("print", printed.grey)
    assert len(view.corners) == len(board.corners_mm())
    places = view.points_mm[:, :2]
    if board.kind == APRILGRID:
        gap = board.spacing * board.square_mm
        places = np.column_stack([gap + places[:, 0], board.size_mm[1] - gap - places[:, 1]])
    expected = places + printed.sheet.place_mm
    found = (view.pixels + 0.5) / printed.px_per_mm
    # A pixel of this picture has 0.34 mm; the upper edge of a picture of 2480.3 rows is rounded.
    assert np.abs(found - expected).max() < 0.07


def test_a_pdf_has_the_size_of_the_paper_and_is_the_same_file_every_time(tmp_path: Path) -> None:
    for name in ("a.pdf", "b.pdf"):
        run("board", "--paper", "a4", "--out", tmp_path / name)
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", content)
    assert box is not None
    points_mm = 25.4 / 72
    assert [float(side) * points_mm for side in box.groups()] == pytest.approx([297, 210], abs=0.01)


def test_the_ruler_of_the_print_is_100_mm_long() -> None:
    printed = texture(CHARUCO_BOARD)
    # The ruler's line is 8 mm above the lower edge of the paper.
    row = printed.grey[-round(8.0 * printed.px_per_mm) - 2 : -round(8.0 * printed.px_per_mm) + 3].min(axis=0)
    dark = np.flatnonzero(row < 200)
    assert (dark[-1] - dark[0] + 1) / printed.px_per_mm == pytest.approx(100, abs=0.6)


def test_an_aprilgrid_is_numbered_and_printed_as_kalibrs() -> None:
    board = APRILGRID_BOARD
    # Kalibr counts corners in rows across all tags: 12 corners in a row of six tags.
    assert board.tag_corners(0).tolist() == [0, 1, 13, 12]
    assert board.tag_corners(7).tolist() == [26, 27, 39, 38]
    assert board.corners_mm()[26, :2].tolist() == pytest.approx([22 * 1.3, 22 * 1.3])
    printed = texture(board)
    left, top = printed.sheet.place_mm
    gap = board.spacing * board.square_mm
    lowest = top + board.size_mm[1] - gap - board.square_mm
    # Kalibr prints tag 0 at the bottom left, with its most significant bit at the upper left.
    assert bits(printed, board, left + gap, lowest) == format(TAG_0, "036b")


def test_an_aprilgrid_whose_tags_are_rotated_is_numbered_the_same() -> None:
    """Other programs print the tags rotated; the places of the tags say where their corners are."""
    board = APRILGRID_BOARD
    upright = texture(board).grey
    expected = detector(board).find("print", upright)
    other = detector(board).find("rotated", cv2.rotate(upright, cv2.ROTATE_90_CLOCKWISE))
    assert other.corners.tolist() == expected.corners.tolist()
    back = np.column_stack([other.pixels[:, 1], upright.shape[0] - 1 - other.pixels[:, 0]])
    assert np.abs(back - expected.pixels).max() < 0.05


def test_a_board_that_is_larger_than_the_paper_is_refused_with_a_size_that_fits() -> None:
    with pytest.raises(TrainerError, match=r"does not fit on a4 .*--square-mm [\d.]+") as refused:
        place(Board(CHARUCO, 8, 6, 40.0), "a4")
    fitting = re.search(r"--square-mm ([\d.]+)", str(refused.value))
    assert fitting is not None
    assert place(Board(CHARUCO, 8, 6, float(fitting.group(1))), "a4").width_mm == 297


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--squares", "2x6"), "too small"),
        (("--square-mm", "0"), "is not a length"),
        (("--square-mm", "20", "--marker-mm", "21"), "is not below the square"),
        (("--dictionary", "DICT_9X9"), "none of OpenCV's"),
        (("--kind", "aprilgrid", "--spacing", "3"), "between 0 and 1"),
        (("--squares", "30x20", "--square-mm", "5"), "300 markers and DICT_5X5_100 has 100"),
        (("--paper", "b5"), "is unknown"),
        (("--out", "board.docx"), "ends in .pdf"),
    ],
)
def test_an_impossible_board_is_refused(options: tuple[str, ...], message: str, tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match=message):
        run("board", "--out", tmp_path / "board.pdf", *options)
    assert not (tmp_path / "board.pdf").exists()


def test_a_print_file_is_not_overwritten_without_force(tmp_path: Path) -> None:
    file = tmp_path / "board.png"
    run("board", "--out", file)
    with pytest.raises(TrainerError, match="exists and is not overwritten"):
        run("board", "--out", file)
    run("board", "--out", file, "--force")
