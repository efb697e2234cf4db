"""The calibration of corners with known noise: values, stated errors, outliers, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from embodied_depth_trainer.camera_calibration.calibration import calibrate
from embodied_depth_trainer.camera_calibration.camera import FISHEYE, PLUMB_BOB, Camera
from embodied_depth_trainer.camera_calibration.checks import Limits
from embodied_depth_trainer.camera_calibration.fit import Fit
from embodied_depth_trainer.camera_calibration.solve import solve
from embodied_depth_trainer.camera_calibration.start import all_poses
from embodied_depth_trainer.camera_calibration.uncertainty import CrossValidation, grid, projected
from embodied_depth_trainer.camera_calibration.views import Observations
from embodied_depth_trainer.errors import TrainerError

from .synthetic import FISH, WIDE, observations

LENSES = pytest.mark.parametrize("camera", [WIDE, FISH], ids=["plumb bob", "fisheye"])


@LENSES
def test_projection_and_its_derivatives_agree(camera: Camera) -> None:
    points = np.random.default_rng(0).normal(size=(20, 3)) + np.array([0, 0, 3])
    _, by_values, by_points = camera.project_with_derivatives(points)
    step = 1e-6
    for index in range(3):
        shift = step * np.eye(3)[index]
        numeric = (camera.project(points + shift) - camera.project(points - shift)) / (2 * step)
        assert np.allclose(numeric, by_points[:, :, index], rtol=1e-5, atol=1e-5)
    for index in range(len(camera.values)):
        shift = step * np.eye(len(camera.values))[index]
        higher = camera.with_values(camera.values + shift).project(points)
        lower = camera.with_values(camera.values - shift).project(points)
        assert np.allclose((higher - lower) / (2 * step), by_values[:, :, index], rtol=1e-5, atol=1e-5)


@LENSES
def test_projection_is_opencvs(camera: Camera) -> None:
    points = np.random.default_rng(0).normal(size=(20, 3)) + np.array([0, 0, 4])
    fx, fy, cx, cy = camera.values[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    nothing = np.zeros(3)
    if camera.model == FISHEYE:
        expected, _ = cv2.fisheye.projectPoints(points[:, None], nothing, nothing, matrix, camera.values[4:])
    else:
        expected, _ = cv2.projectPoints(points, nothing, nothing, matrix, camera.values[4:])
    assert np.allclose(camera.project(points), np.asarray(expected).reshape(-1, 2), atol=1e-6)


@LENSES
def test_the_ray_behind_a_pixel_is_projected_to_it(camera: Camera) -> None:
    pixels = grid(camera).pixels
    rays, valid = camera.rays(pixels)
    assert valid.all()
    assert np.abs(camera.project(rays) - pixels).max() < 1e-6


@LENSES
def test_the_model_and_its_values_are_found(camera: Camera) -> None:
    found = calibrate(observations(camera))
    assert found.camera.model == camera.model
    errors = np.abs(found.camera.values - camera.values)
    assert (errors < 3 * found.deviations).all()
    assert (errors[:2] < 0.002 * camera.values[:2]).all()
    assert found.fit.noise_px == pytest.approx(0.1, rel=0.1)
    assert found.disagreement < 2
    assert not [warning for warning in found.warnings if "cross-validation" in warning]


@LENSES
def test_standard_deviations_hold_the_truth_as_often_as_they_say(camera: Camera) -> None:
    """25 calibrations: 95.4 % of the values are expected within two standard deviations."""
    within = []
    squares = []
    for seed in range(25):
        seen = observations(camera, seed=1000 + seed, views=16)
        solution = solve(camera, all_poses(camera, seen), seen)
        found = Fit(solution, seen, np.ones(len(seen.view), np.bool_))
        error = solution.camera.values - camera.values
        within.append(np.abs(error) < 2 * np.sqrt(np.diag(found.covariance)))
        # The Mahalanobis distance tests the correlations; its expectation is the number of values.
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.91 < np.mean(within) < 0.985
    assert np.mean(squares) == pytest.approx(len(camera.values), rel=0.3)


def test_the_map_of_uncertainty_is_the_error_of_cameras_that_the_covariance_allows() -> None:
    """Root mean square over 300 such cameras, after the rotation is taken out that explains most."""
    seen = observations(WIDE, views=16)
    solution = solve(WIDE, all_poses(WIDE, seen), seen)
    found = Fit(solution, seen, np.ones(len(seen.view), np.bool_))
    random = np.random.default_rng(0)
    others = random.multivariate_normal(solution.camera.values, found.covariance, 300)
    # As in cross-validation, but around their mean and not scaled as calibrations with common views.
    spread = CrossValidation([solution.camera.with_values(values) for values in others], 0.0)
    sampled = spread.differences(solution.camera) / np.sqrt(len(others) - 1)
    assert sampled == pytest.approx(projected(found), rel=0.15)


def test_a_wrong_model_is_told_by_cross_validation() -> None:
    forced = calibrate(observations(WIDE, views=30, seed=2), FISHEYE)
    assert forced.camera.model == FISHEYE
    assert any("--model plumb-bob predicts" in warning for warning in forced.warnings)
    assert forced.disagreement > 1.5
    assert (forced.deviations > np.sqrt(np.diag(forced.fit.covariance))).all()


def test_a_model_that_cannot_describe_the_lens_is_refused() -> None:
    with pytest.raises(TrainerError, match=r"leave --model out|does not fit|agree with each other|rms"):
        calibrate(observations(FISH), PLUMB_BOB)


def test_wrong_corners_and_a_wrong_view_are_named_and_left_out() -> None:
    seen = observations(WIDE)
    pixels = seen.pixels.copy()
    single = np.flatnonzero(seen.view == 3)[5]
    pixels[single] += (4.0, -3.0)
    # A view in which the board was bent or moved during the exposure.
    whole = np.flatnonzero(seen.view == 7)
    pixels[whole] += np.random.default_rng(0).normal(0.0, 2.0, (len(whole), 2))
    found = calibrate(replace(seen, pixels=pixels))
    assert found.fit.outlier_views() == ["view 7"]
    named = found.fit.outlier_corners()
    assert (named[0][0], named[0][1]) == ("view 3", int(seen.corner[single]))
    assert named[0][2] == pytest.approx(5.0, abs=0.7)
    assert (np.abs(found.camera.values - WIDE.values) < 3 * found.deviations).all()


def test_parallel_views_are_refused() -> None:
    with pytest.raises(TrainerError, match=r"parallel in all views.*focal length is not observable; tilt the board"):
        calibrate(observations(WIDE, tilt=0.01))


def test_too_few_views_are_refused() -> None:
    with pytest.raises(TrainerError, match="9 views with the board are too few, 10 are needed"):
        calibrate(observations(WIDE, views=9))


def test_views_of_one_part_of_the_image_are_refused_with_the_parts_that_lack() -> None:
    seen = observations(WIDE, views=40)
    with pytest.raises(TrainerError, match=r"of the image has corners.*board at top right, right, bottom right"):
        calibrate(seen.only((seen.pixels[:, 0] < 420) & (seen.pixels[:, 0] > 0)), limits=Limits(coverage=0.8))


def test_coordinates_that_are_no_numbers_are_refused_with_their_view() -> None:
    seen = observations(WIDE, views=12)
    pixels = seen.pixels.copy()
    pixels[np.flatnonzero(seen.view == 4)[0], 0] = np.nan
    with pytest.raises(TrainerError, match="corners of view 4 have coordinates that are no numbers"):
        calibrate(replace(seen, pixels=pixels))


def test_large_residuals_are_refused() -> None:
    with pytest.raises(TrainerError, match=r"rms of \d.\d\d pixels, above 1; .*--rms-limit"):
        calibrate(observations(WIDE, noise_px=1.0))


def test_a_board_of_another_size_than_stated_changes_only_distances() -> None:
    """Intrinsics do not depend on the scale of the print, so that a wrong --square-mm does no harm."""
    seen = observations(WIDE, views=12)
    larger = replace(seen, points_mm=1.1 * seen.points_mm)
    values = [solve(WIDE, all_poses(WIDE, each), each).camera.values for each in (seen, larger)]
    assert np.allclose(values[0], values[1], rtol=1e-3, atol=1e-3)


def test_views_without_corners_do_not_disturb_the_solver() -> None:
    seen: Observations = observations(WIDE, views=16)
    solution = solve(WIDE, all_poses(WIDE, seen), seen.only(seen.view != 5))
    assert np.isfinite(solution.camera.values).all()
