"""The print file of a board, at true scale."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from embodied_depth_trainer.camera_calibration.board import Board
from embodied_depth_trainer.errors import TrainerError

# Width and height, mm: ISO 216 and ANSI.
PAPERS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "a2": (420.0, 594.0), "letter": (215.9, 279.4)}
# What most printers cannot print at the edges.
MARGIN_MM = 5.0
# Strip below the board for the ruler and the text.
STRIP_MM = 16.0
# A ruler beside the board needs this much.
SIDE_MM = 14.0
RULER_MM = 100.0
# 300 dots per inch is what an office printer has.
PNG_DPI = 300
SUFFIXES = (".pdf", ".png", ".svg")


@dataclass(frozen=True)
class Sheet:
    """A paper with a board on it."""

    board: Board
    width_mm: float
    height_mm: float

    @property
    def place_mm(self) -> tuple[float, float]:
        """Left and upper edge of the board."""
        width, height = self.board.size_mm
        return (self.width_mm - width) / 2, (self.height_mm - STRIP_MM - height) / 2


def place(board: Board, paper: str) -> Sheet:
    """The board on a paper, upright or across, whichever has room."""
    short, long = sorted(paper_mm(paper))
    width, height = board.size_mm
    for across in ((long, short), (short, long)):
        if width + 2 * MARGIN_MM <= across[0] and height + 2 * MARGIN_MM + STRIP_MM <= across[1]:
            return Sheet(board, *across)
    larger = max(
        min((across[0] - 2 * MARGIN_MM) / width, (across[1] - 2 * MARGIN_MM - STRIP_MM) / height)
        for across in ((long, short), (short, long))
    )
    side = np.floor(larger * board.square_mm * 2) / 2
    raise TrainerError(
        f"a board of {width:g} x {height:g} mm does not fit on {paper} ({short:g} x {long:g} mm); give --square-mm "
        f"{side:g}, fewer --squares, or a larger --paper"
    )


def paper_mm(paper: str) -> tuple[float, float]:
    if paper in PAPERS_MM:
        return PAPERS_MM[paper]
    try:
        width, height = (float(part) for part in paper.lower().split("x"))
    except ValueError:
        raise TrainerError(
            f"--paper {paper} is unknown; give {', '.join(PAPERS_MM)} or a size in mm such as 600x400"
        ) from None
    if not (0 < width < 1e4 and 0 < height < 1e4):
        raise TrainerError(f"--paper {paper} is no size of a paper in mm")
    return width, height


def draw(sheet: Sheet, suffix: str) -> bytes:
    """The sheet as a PDF, PNG or SVG file."""
    if suffix not in SUFFIXES:
        raise TrainerError(
            f"a board cannot be written as `{suffix}`; give --out a name that ends in .pdf, .png or .svg"
        )
    figure = Figure((sheet.width_mm / 25.4, sheet.height_mm / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, sheet.width_mm), ylim=(sheet.height_mm, 0))
    axes.set_axis_off()
    _draw_board(axes, sheet)
    _draw_ruler(axes, sheet)
    if sheet.place_mm[0] >= SIDE_MM + MARGIN_MM and sheet.height_mm > RULER_MM + 2 * MARGIN_MM:
        _draw_upright_ruler(axes, sheet)
    stream = io.BytesIO()
    # Without a date, the same board gives the same file.
    metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}, ".png": {"Software": None}}[suffix]
    figure.savefig(stream, format=suffix[1:], dpi=PNG_DPI, metadata=metadata)
    return stream.getvalue()


def _draw_board(axes: Axes, sheet: Sheet) -> None:
    """One path for all shapes, in which a hole's outline makes white."""
    place = np.array(sheet.place_mm)
    outlines = [Outline(place + np.vstack([shape, shape[:1]]), closed=True) for shape in sheet.board.shapes_mm()]
    axes.add_patch(PathPatch(Outline.make_compound_path(*outlines), facecolor="black", edgecolor="none", linewidth=0))


def _draw_ruler(axes: Axes, sheet: Sheet) -> None:
    left = max(sheet.place_mm[0], MARGIN_MM)
    length = min(RULER_MM, np.floor((sheet.width_mm - 2 * MARGIN_MM) / 10) * 10)
    level = sheet.height_mm - MARGIN_MM - 3.0
    for tick in np.arange(0, length + 1, 10):
        axes.plot([left + tick] * 2, [level, level - (3.0 if tick % 50 == 0 else 1.5)], color="black", linewidth=0.5)
    axes.plot([left, left + length], [level, level], color="black", linewidth=0.5)
    width, height = sheet.board.size_mm
    text = f"{sheet.board.describe()}. The black pattern is {width:g} x {height:g} mm."
    hint = f"Print at 100 %. This line is {length:g} mm long."
    axes.text(left, level + 3.6, hint, fontsize=6, va="baseline")
    axes.text(left, level - 4.2, text, fontsize=6, va="baseline")


def _draw_upright_ruler(axes: Axes, sheet: Sheet) -> None:
    """A printer may stretch one direction only, which would falsify fx / fy."""
    column = sheet.place_mm[0] - SIDE_MM / 2
    top = max(sheet.place_mm[1], MARGIN_MM)
    for tick in np.arange(0, RULER_MM + 1, 10):
        axes.plot([column, column - (3.0 if tick % 50 == 0 else 1.5)], [top + tick] * 2, color="black", linewidth=0.5)
    axes.plot([column] * 2, [top, top + RULER_MM], color="black", linewidth=0.5)
    axes.text(column - 4.5, top + RULER_MM / 2, f"{RULER_MM:g} mm", fontsize=6, rotation=90, va="center", ha="center")


def suffix_of(file: Path) -> str:
    return file.suffix.lower()
