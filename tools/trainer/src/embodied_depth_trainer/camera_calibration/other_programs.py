"""Reads the intrinsics that other programs have written: ROS's camera_info and Kalibr's camchain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.camera import COEFFICIENTS, FISHEYE, PLUMB_BOB, Camera
from embodied_depth_trainer.errors import TrainerError

# ROS's names (sensor_msgs/distortion_models.hpp) and Kalibr's.
FISHEYES = ("equidistant", "fisheye")
PLUMB_BOBS = ("plumb_bob", "rational_polynomial", "radtan", "none", "")


def read(file: Path, which: str | None = None) -> tuple[Camera, str]:
    """The camera, and what kind of file it is from. `which` names one of several cameras of a camchain."""
    document = _document(file)
    chain = {key: value for key, value in document.items() if isinstance(value, dict) and "intrinsics" in value}
    if chain:
        name = _chosen(file, sorted(chain), which)
        return _kalibr(file, chain[name]), f"{name} of Kalibr's camchain"
    if which is not None:
        raise TrainerError(f"{file} is no camchain of Kalibr, so that --cam {which} has no meaning; leave it out")
    return _camera_info(file, document), "ROS camera_info"


def _document(file: Path) -> dict[str, Any]:
    try:
        import yaml
    except ImportError:
        raise TrainerError('reading YAML needs PyYAML: pip install -e "tools/trainer[calibrate-camera]"') from None
    try:
        # `ros2 topic echo` separates messages by `---`; all have the same calibration.
        document = next(iter(yaml.safe_load_all(file.read_text().removeprefix("%YAML:1.0"))), None)
    except OSError as problem:
        raise TrainerError(f"cannot read {file}: {problem}") from problem
    except (yaml.YAMLError, UnicodeDecodeError) as problem:
        raise TrainerError(f"{file} is not YAML: {problem}") from problem
    if not isinstance(document, dict):
        raise TrainerError(f"{file} is neither a camera_info of ROS nor a camchain of Kalibr")
    return document


def _chosen(file: Path, names: list[str], which: str | None) -> str:
    if which is None and len(names) > 1:
        raise TrainerError(f"{file} has the cameras {', '.join(names)}; choose one with --cam")
    if which is not None and which not in names:
        raise TrainerError(f"{file} has no camera {which}; it has {', '.join(names)}")
    return which or names[0]


def _kalibr(file: Path, entry: dict[str, Any]) -> Camera:
    model = entry.get("camera_model", "pinhole")
    if model != "pinhole":
        raise TrainerError(
            f"{file} has the camera model `{model}`, which the robot does not have; calibrate with pinhole-radtan or "
            "pinhole-equi"
        )
    width, height = _numbers(file, "resolution", entry.get("resolution"), 2)
    intrinsics = _numbers(file, "intrinsics", entry.get("intrinsics"), 4)
    name = str(entry.get("distortion_model", "none"))
    return _camera(file, width, height, intrinsics, name, entry.get("distortion_coeffs", []))


def _camera_info(file: Path, document: dict[str, Any]) -> Camera:
    """The file of `camera_calibration_parsers`, or a message as `ros2 topic echo` prints it."""
    matrix = _data(document, "camera_matrix", "k", "K")
    width = document.get("image_width", document.get("width"))
    height = document.get("image_height", document.get("height"))
    if matrix is None or width is None or height is None:
        raise TrainerError(
            f"{file} is neither a camera_info of ROS (image_width, image_height, camera_matrix) nor a camchain of "
            "Kalibr (cam0 with intrinsics)"
        )
    _require_whole_image(file, document)
    k = _numbers(file, "camera_matrix", matrix, 9)
    if k[1] != 0:
        raise TrainerError(f"{file} has a skew of {k[1]:g}, which the robot's camera model does not have")
    size = _numbers(file, "image size", [width, height], 2)
    name = str(document.get("distortion_model", "plumb_bob"))
    distortion = _data(document, "distortion_coefficients", "d", "D")
    return _camera(file, size[0], size[1], k[[0, 4, 2, 5]], name, [] if distortion is None else distortion)


def _data(document: dict[str, Any], *names: str) -> Any:  # noqa: ANN401
    for name in names:
        if name in document:
            value = document[name]
            return value.get("data") if isinstance(value, dict) else value
    return None


def _require_whole_image(file: Path, document: dict[str, Any]) -> None:
    roi = document.get("roi") or {}
    cropped = any(roi.get(key) for key in ("x_offset", "y_offset"))
    binned = any(document.get(key, 0) not in (0, 1) for key in ("binning_x", "binning_y"))
    if cropped or binned:
        raise TrainerError(
            f"{file} describes a cropped or binned image; give a camera_info of the whole image, and --width and "
            "--height for the size in [devices.camera]"
        )


def _numbers(file: Path, name: str, value: Any, count: int | None = None) -> Floats:  # noqa: ANN401
    try:
        found = np.array(value, np.float64).ravel()
    except (TypeError, ValueError):
        found = np.zeros(0)
    if (count is not None and len(found) != count) or not np.isfinite(found).all():
        wanted = "numbers" if count is None else f"{count} numbers"
        raise TrainerError(f"`{name}` in {file} must be {wanted}, and is {value}")
    return found


def _camera(
    file: Path,
    width: float,
    height: float,
    intrinsics: Floats,
    name: str,
    coefficients: Any,  # noqa: ANN401
) -> Camera:
    values = _numbers(file, "distortion", coefficients)
    if name in FISHEYES:
        model = FISHEYE
    elif name in PLUMB_BOBS:
        model = PLUMB_BOB
        if len(values) > 5 and values[5:].any():
            raise TrainerError(
                f"{file} has {name} with {len(values)} coefficients, and the robot has the first five (k1 k2 p1 p2 "
                "k3); calibrate again with `calibrate-camera images`"
            )
        values = values[:5]
    else:
        raise TrainerError(
            f"{file} has the distortion `{name}`; the robot has plumb_bob (radtan) and equidistant (fisheye)"
        )
    wanted = len(COEFFICIENTS[model])
    if model == FISHEYE and len(values) != wanted:
        raise TrainerError(f"{file} has {len(values)} coefficients of {name}, and four are needed")
    padded = np.zeros(wanted)
    padded[: len(values)] = values
    return Camera(model, int(width), int(height), np.concatenate([intrinsics, padded]))
