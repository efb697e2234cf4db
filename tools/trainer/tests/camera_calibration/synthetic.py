"""Synthetic cameras: views of a board as corners, and images of a printed sheet by ray casting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats, Image
from embodied_depth_trainer.camera_calibration.board import APRILGRID, CHARUCO, Board
from embodied_depth_trainer.camera_calibration.camera import FISHEYE, PLUMB_BOB, Camera
from embodied_depth_trainer.camera_calibration.poses import rotations
from embodied_depth_trainer.camera_calibration.sheet import PNG_DPI, Sheet, draw, place
from embodied_depth_trainer.camera_calibration.views import Observations, View, table

WIDTH = 640
HEIGHT = 480
# A wide lens with much barrel distortion, and a fisheye lens of 150 degrees.
WIDE = Camera(PLUMB_BOB, WIDTH, HEIGHT, np.array([420.0, 421.0, 322.0, 238.0, -0.28, 0.09, 0.001, -0.0005, -0.01]))
FISH = Camera(FISHEYE, WIDTH, HEIGHT, np.array([245.0, 246.0, 317.0, 242.0, -0.02, 0.005, -0.002, 0.0003]))
CHARUCO_BOARD = Board(CHARUCO, 8, 6, 30.0)
APRILGRID_BOARD = Board(APRILGRID, 6, 6, 22.0)
# Corners of which at least this many must be visible in a view.
VISIBLE = 12


@dataclass(frozen=True)
class Pose:
    """Where the board is in the camera."""

    rotation: Floats
    place_mm: Floats


def pose(random: np.random.Generator, camera: Camera, board: Board, index: int, tilt: float, nearest_mm: float) -> Pose:
    """A pose whose board's middle is in the next part of the image, so that views cover it."""
    columns, rows = 4, 3
    part = np.array([index % columns, index // columns % rows])
    size = np.array([camera.width, camera.height])
    aim = (part + random.uniform(0.15, 0.85, 2)) / (columns, rows) * size
    ray = camera.rays(aim[None])[0][0]
    rotation = rotations(random.uniform(-tilt, tilt, (1, 3)))[0]
    middle = board.corners_mm().mean(axis=0)
    # The Aprilgrid's y points up.
    if board.kind == APRILGRID:
        rotation = rotation @ np.diag([1.0, -1.0, -1.0])
    return Pose(rotation, ray * random.uniform(nearest_mm, 1.8 * nearest_mm) - rotation @ middle)


def observations(
    camera: Camera,
    board: Board = CHARUCO_BOARD,
    views: int = 24,
    seed: int = 0,
    noise_px: float = 0.1,
    tilt: float = 0.6,
    nearest_mm: float = 250.0,
) -> Observations:
    """Corners as a detector with this noise would find them."""
    random = np.random.default_rng(seed)
    corners = board.corners_mm()
    found: list[View] = []
    index = 0
    while len(found) < views:
        placed = pose(random, camera, board, index, tilt, nearest_mm)
        index += 1
        points = corners @ placed.rotation.T + placed.place_mm
        pixels = camera.project(points)
        with np.errstate(invalid="ignore"):
            inside = (pixels > 3).all(axis=1) & (pixels < (camera.width - 4, camera.height - 4)).all(axis=1)
        # A plumb bob shows points beyond its valid angle a second time.
        angles = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        inside &= angles < 0.95 * camera.valid_angle()
        if inside.sum() < VISIBLE:
            continue
        seen = pixels[inside] + random.normal(0.0, noise_px, (int(inside.sum()), 2))
        found.append(View(f"view {len(found)}", np.flatnonzero(inside), corners[inside], seen))
    return table(found, (camera.width, camera.height))


@dataclass(frozen=True)
class Texture:
    """A printed sheet as a picture."""

    sheet: Sheet
    grey: Image
    px_per_mm: float


@cache
def texture(board: Board) -> Texture:
    """The print file itself, so that the images also test its scale."""
    sheet = place(board, "a4")
    grey = cv2.imdecode(np.frombuffer(draw(sheet, ".png"), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    # A texel is about as large as a sample of the picture, which avoids aliasing.
    smaller = 4
    rows, columns = (side // smaller for side in grey.shape)
    whole = grey[: rows * smaller, : columns * smaller]
    texels = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return Texture(sheet, texels, PNG_DPI / 25.4 / smaller)


# Rays are computed at every fourth pixel. Between them they are linear but for 0.01 pixels.
RAY_STEP = 4


@cache
def _rays(key: tuple[str, int, int, tuple[float, ...]], samples: int) -> Floats:
    """A ray for each of `samples` x `samples` points in every pixel."""
    camera = Camera(key[0], key[1], key[2], np.array(key[3]))
    x = np.arange(-RAY_STEP, camera.width + RAY_STEP, RAY_STEP, dtype=np.float64)
    y = np.arange(-RAY_STEP, camera.height + RAY_STEP, RAY_STEP, dtype=np.float64)
    columns, rows = np.meshgrid(x, y)
    rays, valid = camera.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    # Behind the camera, where no sheet is.
    rays[~valid] = (0.0, 0.0, -1.0)
    coarse = rays.reshape(len(y), len(x), 3)
    across = np.einsum("sx,yxi->ysi", _between(x, camera.width, samples), coarse)
    fine: Floats = np.einsum("ty,ysi->tsi", _between(y, camera.height, samples), across)
    return fine.reshape(-1, 3)


def _between(nodes: Floats, pixels: int, samples: int) -> Floats:
    """Weights that interpolate from nodes to the samples of pixels."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    places = (np.arange(pixels)[:, None] + offsets).ravel()
    return np.stack([np.interp(places, nodes, unit) for unit in np.eye(len(nodes))], axis=1)


def render(
    camera: Camera,
    board: Board,
    placed: Pose,
    seed: int = 0,
    noise: float = 2.0,
    blur_px: float = 0.6,
    samples: int = 2,
) -> Image:
    """A picture of the sheet on a grey wall: rays are cast at the sheet's plane, then come blur, noise and rounding."""
    rays = _rays((camera.model, camera.width, camera.height, tuple(camera.values.tolist())), samples)
    sheet = texture(board)
    # In the board's frame the sheet is the plane z = 0.
    origin = -placed.rotation.T @ placed.place_mm
    directions = rays @ placed.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        along = -origin[2] / directions[:, 2]
        hits = origin[:2] + along[:, None] * directions[:, :2]
    with np.errstate(invalid="ignore"):
        hits[~(along > 0)] = -1e6
    left, top = sheet.sheet.place_mm
    if board.kind == APRILGRID:
        gap = board.spacing * board.square_mm
        hits = np.column_stack([hits[:, 0] + gap, board.size_mm[1] - gap - hits[:, 1]])
    texels = ((hits + np.array([left, top])) * sheet.px_per_mm - 0.5).astype(np.float32)
    shape = (camera.height * samples, camera.width * samples)
    fine = cv2.remap(
        sheet.grey,
        texels[:, 0].reshape(shape),
        texels[:, 1].reshape(shape),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(110.0,),
    )
    grey = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA).astype(np.float64)
    # Ink is not black and paper is not white.
    picture = np.asarray(cv2.GaussianBlur(25.0 + 0.75 * grey, (0, 0), blur_px), np.float64)
    picture += np.random.default_rng(seed).normal(0.0, noise, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def images(camera: Camera, board: Board, views: int, seed: int = 0, nearest_mm: float = 250.0) -> list[Image]:
    random = np.random.default_rng(seed)
    poses = [pose(random, camera, board, index, 0.6, nearest_mm) for index in range(views)]
    return [render(camera, board, placed, index) for index, placed in enumerate(poses)]
