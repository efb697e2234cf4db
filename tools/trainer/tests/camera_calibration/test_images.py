"""From images to `lens.toml`: images are rendered from the print file, by cameras with known intrinsics."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from embodied_depth_trainer.camera_calibration.arrays import Floats, Image
from embodied_depth_trainer.camera_calibration.board import APRILGRID, Board
from embodied_depth_trainer.camera_calibration.camera import FISHEYE, Camera
from embodied_depth_trainer.errors import TrainerError

from .cli import run
from .synthetic import CHARUCO_BOARD, FISH, WIDE, images

# Large tags, because the bits of small ones are lost at the edge of a fisheye's image of 640 pixels.
SMALL_APRILGRID = Board(APRILGRID, 4, 4, 32.0)


def save(folder: Path, shown: list[Image]) -> Path:
    folder.mkdir()
    for index, picture in enumerate(shown):
        assert cv2.imwrite(str(folder / f"{index:02d}.png"), picture)
    return folder


def board_options(board: Board) -> list[str]:
    squares = f"{board.columns}x{board.rows}"
    return ["--kind", board.kind, "--squares", squares, "--square-mm", str(board.square_mm)]


@pytest.mark.parametrize(
    ("camera", "board", "views", "nearest_mm"),
    [(WIDE, CHARUCO_BOARD, 16, 250.0), (FISH, SMALL_APRILGRID, 22, 140.0)],
    ids=["plumb bob, ChArUco", "fisheye, AprilGrid"],
)
def test_pictures_of_a_known_lens_give_its_values_within_the_stated_errors(
    camera: Camera, board: Board, views: int, nearest_mm: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Images that are damaged, or without the board, are named and skipped."""
    folder = save(tmp_path / "images", images(camera, board, views, 0, nearest_mm))
    (folder / "80.png").write_bytes((folder / "03.png").read_bytes()[:60])
    (folder / "81.png").write_bytes(b"")
    cv2.imwrite(str(folder / "82.png"), np.full((480, 640), 128, np.uint8))
    out = tmp_path / "lens.toml"
    run("images", folder / "*.png", *board_options(board), "--least-coverage", "0.5", "--out", out)
    said = capsys.readouterr().out
    assert "skipped 80.png: it is no readable image" in said
    assert "skipped 81.png: it is no readable image" in said
    assert "skipped 82.png: 0 corners of the board were found" in said
    assert f"The model is {camera.model}" in said
    assert "uncertainty of the projection" in said
    assert "without the board" in out.read_text()
    values, deviations = written_lens(out, camera)
    assert (np.abs(values - camera.values) < 3 * deviations).all()
    assert (np.abs(values[:2] - camera.values[:2]) < 0.003 * camera.values[:2]).all()
    assert (np.abs(values[2:4] - camera.values[2:4]) < 1.0).all()
    picture = cv2.imread(str(tmp_path / "lens.png"))
    assert picture is not None
    assert picture.shape[1] > 1000


def written_lens(file: Path, camera: Camera) -> tuple[Floats, Floats]:
    """Values and standard deviations in a file, which must have the keys of the robot's configuration."""
    written = tomllib.loads(file.read_text())
    assert written["devices"]["camera"] == {"width": camera.width, "height": camera.height}
    lens = written["devices"]["lens"]
    assert set(lens) == {"fx", "fy", "cx", "cy", "distortion"}
    assert len(lens["distortion"]) == (4 if camera.model == FISHEYE else 5)
    values = np.array([lens["fx"], lens["fy"], lens["cx"], lens["cy"], *lens["distortion"]])
    return values, stated_deviations(file)


def stated_deviations(file: Path) -> Floats:
    """The standard deviation in every key's comment, in the order of the file."""
    lines = [
        line for line in file.read_text().splitlines() if not line.startswith("#") and "standard deviation" in line
    ]
    return np.array([float(line.split("standard deviation ")[1]) for line in lines])


def test_pictures_of_different_sizes_are_refused_with_their_names(tmp_path: Path) -> None:
    folder = save(tmp_path / "images", [np.zeros((480, 640), np.uint8), np.zeros((240, 320), np.uint8)])
    with pytest.raises(TrainerError, match=r"different sizes \(320 x 240: 01.png; 640 x 480: 00.png\)"):
        run("images", folder, "--out", tmp_path / "lens.toml")


def test_pictures_without_any_board_are_refused(tmp_path: Path) -> None:
    folder = save(tmp_path / "images", [np.zeros((480, 640), np.uint8)] * 2)
    with pytest.raises(TrainerError, match="the board was found in no picture"):
        run("images", folder, "--out", tmp_path / "lens.toml")
    with pytest.raises(TrainerError, match="there are no images"):
        run("images", tmp_path / "nothing", "--out", tmp_path / "lens.toml")
    assert not (tmp_path / "lens.toml").exists()


def test_an_existing_file_is_refused_before_pictures_are_read(tmp_path: Path) -> None:
    (tmp_path / "lens.toml").write_text("mine = true\n")
    with pytest.raises(TrainerError, match=r"lens.toml exists and is not overwritten; give another --out, or --force"):
        run("images", tmp_path / "nothing", "--out", tmp_path / "lens.toml")
    assert (tmp_path / "lens.toml").read_text() == "mine = true\n"
