"""`embodied-depth calibrate-camera`: measures the camera's intrinsics with a printed board."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from embodied_depth_trainer.camera_calibration import (
    board,
    calibration,
    checks,
    detect,
    images,
    lens_file,
    live,
    other_programs,
    picture,
    report,
    sheet,
)
from embodied_depth_trainer.camera_calibration.board import Board
from embodied_depth_trainer.camera_calibration.camera import MODELS
from embodied_depth_trainer.camera_calibration.images import Found
from embodied_depth_trainer.camera_calibration.lens_file import Lens
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically

Action = Callable[[argparse.Namespace], None]
Actions: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_calibrate_camera(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True)
    printed = _action(actions, "board", "write the print file of a board", _board)
    _add_board(printed)
    printed.add_argument(
        "--paper", default="a4", help=f"{', '.join(sheet.PAPERS_MM)}, or width x height in mm such as 600x400 [a4]"
    )
    printed.add_argument("--out", type=Path, required=True, help="file to write: .pdf, .svg or .png")
    printed.add_argument("--force", action="store_true", help="overwrite the file")
    images = _action(actions, "images", "calibrate from images of a board", _images)
    images.add_argument("source", nargs="+", help="folders, patterns such as 'shots/*.png', or files")
    _add_calibration(images)
    stream = _action(actions, "camera", "calibrate from a live camera", _camera)
    stream.add_argument("source", help="camera such as /dev/video0, or a video file")
    stream.add_argument("--keep", type=Path, metavar="FOLDER", help="save the frames of the views for `images`")
    _add_calibration(stream)
    taken = _action(actions, "import", "take over a camera_info of ROS or a camchain of Kalibr", _import)
    taken.add_argument("source", type=Path, help="YAML file")
    taken.add_argument("--cam", help="camera of a camchain, such as cam0 [the only one]")
    _add_output(taken)


def run_calibrate_camera(options: argparse.Namespace) -> None:
    options.run_action(options)


def _action(actions: Actions, name: str, help_text: str, run: Action) -> argparse.ArgumentParser:
    action = actions.add_parser(name, help=help_text, description=help_text)
    action.set_defaults(run_action=run)
    return action


def _add_board(action: argparse.ArgumentParser) -> None:
    action.add_argument("--kind", choices=board.KINDS, default=board.CHARUCO, help="kind of the board [charuco]")
    action.add_argument(
        "--squares", type=_squares, default=(8, 6), metavar="8x6", help="columns x rows of squares, or of tags [8x6]"
    )
    action.add_argument(
        "--square-mm", type=float, default=30.0, help="side of a square, or of a tag, measured on the print [30]"
    )
    action.add_argument(
        "--marker-mm", type=float, default=0.0, help="ChArUco: side of a marker [three quarters of the square]"
    )
    action.add_argument("--dictionary", default=board.DICTIONARY, help=f"ChArUco: OpenCV's name [{board.DICTIONARY}]")
    action.add_argument(
        "--legacy-pattern", action="store_true", help="ChArUco: a board made by OpenCV before 4.6 with even rows"
    )
    action.add_argument(
        "--spacing", type=float, default=board.SPACING, help="AprilGrid: gap between tags divided by their side [0.3]"
    )


def _squares(text: str) -> tuple[int, int]:
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not a number of squares such as 8x6 (columns x rows)") from None
    return columns, rows


def _add_output(action: argparse.ArgumentParser) -> None:
    action.add_argument("--width", type=int, help="width in [devices.camera], if it differs from that of the images")
    action.add_argument("--height", type=int, help="height in [devices.camera], likewise")
    action.add_argument("--out", type=Path, default=Path("lens.toml"), help="file to write [lens.toml]")
    action.add_argument("--force", action="store_true", help="overwrite the file and its picture")


def _add_calibration(action: argparse.ArgumentParser) -> None:
    _add_board(action)
    action.add_argument(
        "--model",
        choices=(calibration.AUTO, *MODELS),
        default=calibration.AUTO,
        help="camera model; auto takes the one that predicts unseen views better [auto]",
    )
    action.add_argument("--rms-limit", type=float, default=1.0, help="largest rms of the residuals in pixels [1]")
    action.add_argument(
        "--least-coverage",
        type=float,
        default=checks.LEAST_COVERAGE,
        help=f"least share of the image with corners [{checks.LEAST_COVERAGE}]",
    )
    _add_output(action)


def _board_of(options: argparse.Namespace) -> Board:
    columns, rows = options.squares
    return Board(
        options.kind,
        columns,
        rows,
        options.square_mm,
        options.marker_mm,
        options.dictionary,
        options.spacing,
        options.legacy_pattern,
    )


def _board(options: argparse.Namespace) -> None:
    lens_file.require_free(options.out, options.force)
    placed = sheet.place(_board_of(options), options.paper)
    write_atomically(sheet.draw(placed, sheet.suffix_of(options.out)), options.out)
    print(
        f"{options.out}: {placed.board.describe()}; print it at 100 % on {placed.width_mm:g} x {placed.height_mm:g} mm"
    )


def _images(options: argparse.Namespace) -> None:
    _require_free_output(options)
    printed = _board_of(options)
    paths = images.files(options.source)
    _calibrate(options, printed, images.find(paths, detect.detector(printed)), ", ".join(options.source))


def _camera(options: argparse.Namespace) -> None:
    _require_free_output(options)
    printed = _board_of(options)
    stream, misses = live.open_stream(options.source, options.width, options.height)
    found = live.collect(stream, detect.detector(printed), _say, options.keep, misses)
    _calibrate(options, printed, found, options.source)


def _say(line: str) -> None:
    # A person at the camera must see it at once, also through a pipe.
    print(line, flush=True)


def _import(options: argparse.Namespace) -> None:
    lens_file.require_free(options.out, options.force)
    camera, kind = other_programs.read(options.source, options.cam)
    _write(options, Lens(camera, None, report.imported(options.source.name, kind, camera)))


def _picture_of(options: argparse.Namespace) -> Path:
    out: Path = options.out
    return out.with_suffix(".png")


def _require_free_output(options: argparse.Namespace) -> None:
    if options.out.suffix == ".png":
        raise TrainerError(f"--out {options.out} is the name of the picture; give one that ends in .toml")
    for file in (options.out, _picture_of(options)):
        lens_file.require_free(file, options.force)


def _calibrate(options: argparse.Namespace, printed: Board, found: Found, source: str) -> None:
    limits = checks.Limits(rms_px=options.rms_limit, coverage=options.least_coverage)
    for name, why in found.skipped:
        print(f"skipped {name}: {why}")
    result = calibration.calibrate(found.seen, options.model, limits)
    print("\n".join(report.lines(result)))
    _write(
        options, Lens(result.camera, result.deviations, report.provenance(result, printed, source, len(found.skipped)))
    )
    title = f"{source}: {result.camera.model}, {result.camera.width} x {result.camera.height}"
    picture.draw(result, title, _picture_of(options))
    print(_picture_of(options))


def _write(options: argparse.Namespace, lens: Lens) -> None:
    scaled = lens_file.resized(lens, options.width, options.height)
    lens_file.write(scaled, options.out)
    camera = scaled.camera
    print(f"{options.out}: {camera.model}, {camera.width} x {camera.height}, fx {camera.values[0]:.3f}")
