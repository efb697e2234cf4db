"""Intrinsics of other programs as `[devices.lens]`."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from embodied_depth_trainer.errors import TrainerError

from .cli import run

CAMERA_INFO = """\
image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: [420.5, 0, 321.25, 0, 421.5, 238.75, 0, 0, 1]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: [{coefficients}]
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""
CAMCHAIN = """\
cam0:
  camera_model: pinhole
  intrinsics: [461.6, 460.2, 363.0, 248.1]
  distortion_model: radtan
  distortion_coeffs: [-0.29, 0.08, -0.0002, 0.00002]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: 0.005
cam1:
  camera_model: pinhole
  intrinsics: [190.9, 190.9, 254.9, 256.8]
  distortion_model: equidistant
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  resolution: [512, 512]
  rostopic: /cam1/image_raw
"""
ECHO = """\
header: {frame_id: camera}
height: 480
width: 640
distortion_model: plumb_bob
d: [-0.28, 0.09, 0.001, -0.0005, -0.01]
k: [420.5, 0.0, 321.25, 0.0, 421.5, 238.75, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
"""


def camera_info(model: str, *coefficients: float) -> str:
    listed = ", ".join(str(value) for value in coefficients)
    return CAMERA_INFO.format(model=model, count=len(coefficients), coefficients=listed)


def imported(folder: Path, content: str, *options: object) -> dict[str, Any]:
    (folder / "source.yaml").write_text(content)
    run("import", folder / "source.yaml", "--out", folder / "lens.toml", "--force", *options)
    found: dict[str, Any] = tomllib.loads((folder / "lens.toml").read_text())["devices"]
    return found


@pytest.mark.parametrize(
    ("content", "distortion"),
    [
        (camera_info("plumb_bob", -0.28, 0.09, 0.001, -0.0005, -0.01), [-0.28, 0.09, 0.001, -0.0005, -0.01]),
        (camera_info("plumb_bob", -0.28, 0.09, 0.001, -0.0005), [-0.28, 0.09, 0.001, -0.0005, 0.0]),
        (camera_info("plumb_bob", 0, 0, 0, 0, 0), []),
        (camera_info("rational_polynomial", -0.28, 0.09, 0.001, 0, -0.01, 0, 0, 0), [-0.28, 0.09, 0.001, 0, -0.01]),
        (camera_info("equidistant", -0.02, 0.005, -0.002, 0.0003), [-0.02, 0.005, -0.002, 0.0003]),
        (camera_info("fisheye", -0.02, 0.005, -0.002, 0.0003), [-0.02, 0.005, -0.002, 0.0003]),
        (ECHO, [-0.28, 0.09, 0.001, -0.0005, -0.01]),
    ],
)
def test_a_camera_info_becomes_a_lens(content: str, distortion: list[float], tmp_path: Path) -> None:
    found = imported(tmp_path, content)
    assert found["camera"] == {"width": 640, "height": 480}
    lens = found["lens"]
    assert (lens["fx"], lens["fy"], lens["cx"], lens["cy"]) == (420.5, 421.5, 321.25, 238.75)
    assert lens["distortion"] == pytest.approx(distortion)


def test_each_camera_of_a_camchain_becomes_a_lens(tmp_path: Path) -> None:
    found = imported(tmp_path, CAMCHAIN, "--cam", "cam0")
    assert found["camera"] == {"width": 752, "height": 480}
    assert found["lens"]["distortion"] == pytest.approx([-0.29, 0.08, -0.0002, 0.00002, 0.0])
    found = imported(tmp_path, CAMCHAIN, "--cam", "cam1")
    assert (found["lens"]["fx"], found["lens"]["cy"]) == (190.9, 256.8)
    assert found["lens"]["distortion"] == pytest.approx([0.003, 0.0007, -0.002, 0.0002])
    assert "its errors are unknown" in (tmp_path / "lens.toml").read_text()


def test_a_lens_can_be_scaled_to_the_size_of_the_robots_images(tmp_path: Path) -> None:
    content = camera_info("plumb_bob", -0.28, 0.09, 0.001, -0.0005, -0.01)
    found = imported(tmp_path, content, "--width", 320, "--height", 240)
    assert found["camera"] == {"width": 320, "height": 240}
    # The outer edges of both images coincide, and the centre of the first pixel is 0 in both.
    lens = found["lens"]
    assert (lens["fx"], lens["cx"], lens["cy"]) == (210.25, (321.25 + 0.5) / 2 - 0.5, (238.75 + 0.5) / 2 - 0.5)
    with pytest.raises(TrainerError, match="320 x 200 has another shape: the camera crops"):
        imported(tmp_path, content, "--width", 320, "--height", 200)
    with pytest.raises(TrainerError, match="give both --width and --height"):
        imported(tmp_path, content, "--width", 320)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            camera_info("rational_polynomial", 1, 2, 0, 0, 3, 4, 5, 6),
            "with 8 coefficients, and the robot has the first",
        ),
        (camera_info("equidistant", 0.1, 0.2), "has 2 coefficients of equidistant, and four are needed"),
        (camera_info("thin_prism", 0.1), "the robot has plumb_bob"),
        (camera_info("plumb_bob", 0.1).replace("420.5, 0,", "420.5, 3,"), "skew of 3"),
        (camera_info("plumb_bob", 0.1).replace("420.5", ".nan"), "must be 9 numbers"),
        (camera_info("plumb_bob", 0.1).replace("420.5", "0.1"), "fx = 0.1 is not within"),
        (ECHO.replace("binning_x: 0", "binning_x: 2"), "cropped or binned"),
        (CAMCHAIN, "has the cameras cam0, cam1; choose one with --cam"),
        (CAMCHAIN.replace("cam1", "other").replace("pinhole", "omni"), "has the cameras"),
        ("a: 1\n", "neither a camera_info of ROS"),
        ("[1, 2\n", "is not YAML"),
        ("just text\n", "neither a camera_info"),
    ],
)
def test_what_the_robot_cannot_use_is_refused(content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match=message):
        imported(tmp_path, content)
    assert not (tmp_path / "lens.toml").exists()


def test_another_camera_model_of_kalibr_and_an_unknown_camera_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match="the camera model `omni`, which the robot does not have"):
        imported(tmp_path, CAMCHAIN.replace("pinhole", "omni"), "--cam", "cam0")
    with pytest.raises(TrainerError, match="has no camera cam7; it has cam0, cam1"):
        imported(tmp_path, CAMCHAIN, "--cam", "cam7")
    with pytest.raises(TrainerError, match="cannot read"):
        run("import", tmp_path / "missing.yaml", "--out", tmp_path / "lens.toml")
