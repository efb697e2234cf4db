"""Views of a board from image files."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Image
from embodied_depth_trainer.camera_calibration.detect import Detector
from embodied_depth_trainer.camera_calibration.fit import LEAST_CORNERS
from embodied_depth_trainer.camera_calibration.opencv import opencv
from embodied_depth_trainer.camera_calibration.views import Observations, View, table
from embodied_depth_trainer.errors import TrainerError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")


@dataclass(frozen=True)
class Found:
    """The views of all images, and which images have none."""

    views: list[View]
    size: tuple[int, int]
    """Width and height of the images."""
    skipped: list[tuple[str, str]]
    """Images without a view, and why."""

    @property
    def seen(self) -> Observations:
        if not self.views:
            reasons = "; ".join(f"{name}: {why}" for name, why in self.skipped[:5])
            raise TrainerError(f"the board was found in no picture ({reasons}); check --kind and --squares against it")
        return table(self.views, self.size)


def files(sources: Sequence[str]) -> list[Path]:
    """The image files of folders, patterns and names, sorted by name."""
    found: set[Path] = set()
    for source in sources:
        path = Path(source)
        if path.is_dir():
            found |= {file for file in path.iterdir() if file.suffix.lower() in SUFFIXES}
        else:
            found |= {path} if path.is_file() else {Path(name) for name in glob.glob(source, recursive=True)}
    if not found:
        raise TrainerError(f"there are no images in {', '.join(sources)}; known are {', '.join(SUFFIXES)}")
    return sorted(found)


def find(paths: Sequence[Path], detector: Detector) -> Found:
    """Searches every picture for the board."""
    views = []
    skipped = []
    sizes: dict[tuple[int, int], list[str]] = {}
    for path in paths:
        picture = _read(path)
        if picture is None:
            skipped.append((path.name, "it is no readable image"))
            continue
        sizes.setdefault((picture.shape[1], picture.shape[0]), []).append(path.name)
        view = detector.find(path.name, picture)
        if len(view.corners) < LEAST_CORNERS:
            skipped.append(
                (path.name, f"{len(view.corners)} corners of the board were found, {LEAST_CORNERS} are needed")
            )
        else:
            views.append(view)
    if not sizes:
        raise TrainerError(f"none of the {len(paths)} images can be read; the first is {paths[0]}")
    _require_one_size(sizes)
    return Found(views, next(iter(sizes)), skipped)


def _read(path: Path) -> Image | None:
    cv2 = opencv()
    # imdecode says nothing about damaged files, and imread prints warnings for them.
    picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_GRAYSCALE) if path.stat().st_size else None
    return None if picture is None else np.asarray(picture)


def _require_one_size(sizes: dict[tuple[int, int], list[str]]) -> None:
    if len(sizes) == 1:
        return
    told = "; ".join(
        f"{width} x {height}: {', '.join(names[:3])}{' and others' if len(names) > 3 else ''}"
        for (width, height), names in sorted(sizes.items())
    )
    raise TrainerError(f"the images have different sizes ({told}); give those of one camera at one size")
