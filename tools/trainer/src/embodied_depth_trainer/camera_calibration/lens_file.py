"""`lens.toml`: the intrinsics as keys of the robot's configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.camera import Camera
from embodied_depth_trainer.camera_calibration.checks import require_allowed
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically

# The sides of both sizes may differ by rounding, such as 1080 / 1920 and 270 / 480.
SAME_RATIO = 0.005


@dataclass(frozen=True)
class Lens:
    """What the file says."""

    camera: Camera
    deviations: Floats | None
    """Standard deviations of the intrinsics, where they are known."""
    provenance: Sequence[str]
    """Lines about when and of what the intrinsics were made."""


def resized(lens: Lens, width: int | None, height: int | None) -> Lens:
    """The lens for the size at which the robot uses the camera. A crop has another centre, which cannot be known."""
    camera = lens.camera
    if width is None and height is None:
        return lens
    if width is None or height is None:
        raise TrainerError("give both --width and --height, as in [devices.camera]")
    if min(width, height) <= 0 or abs(width * camera.height / (height * camera.width) - 1) > SAME_RATIO:
        raise TrainerError(
            f"the images have {camera.width} x {camera.height} pixels and {width} x {height} has another shape: the "
            "camera crops at one of them; calibrate with images of the size in [devices.camera]"
        )
    if (width, height) == (camera.width, camera.height):
        return lens
    scaled = camera.resized(width, height)
    deviations = None
    if lens.deviations is not None:
        scale = np.ones(len(lens.deviations))
        scale[:4] = [width / camera.width, height / camera.height] * 2
        deviations = lens.deviations * scale
    note = f"Scaled from {camera.width} x {camera.height} pixels; the camera must not crop at either size."
    return Lens(scaled, deviations, [*lens.provenance, note])


def text(lens: Lens) -> str:
    camera = lens.camera
    require_allowed(camera)
    lines = [*(f"# {line}" for line in lens.provenance), "", "[devices.camera]"]
    lines += [f"width = {camera.width}", f"height = {camera.height}", "", "[devices.lens]"]
    for index, name in enumerate(camera.names[:4]):
        lines.append(f"{name} = {camera.values[index]:.4f}{_deviation(lens, index, ' # ')}")
    if not camera.values[4:].any():
        return "\n".join([*lines, "distortion = [] # none", ""])
    lines.append("distortion = [")
    for index, name in enumerate(camera.names[4:], 4):
        lines.append(f"    {camera.values[index]:.8f}, # {name}{_deviation(lens, index, ', ')}")
    return "\n".join([*lines, "]", ""])


def _deviation(lens: Lens, index: int, before: str) -> str:
    return "" if lens.deviations is None else f"{before}standard deviation {lens.deviations[index]:.2g}"


def require_free(file: Path, force: bool) -> None:
    """Refuses an existing file before any work is done for it."""
    if file.exists() and not force:
        raise TrainerError(f"{file} exists and is not overwritten; give another --out, or --force")


def write(lens: Lens, file: Path) -> None:
    write_atomically(text(lens).encode(), file)
