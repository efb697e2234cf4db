"""The calibration of a camera: fits both models to views, chooses one, and says how certain it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_depth_trainer.camera_calibration import checks, uncertainty
from embodied_depth_trainer.camera_calibration.arrays import Floats
from embodied_depth_trainer.camera_calibration.camera import MODELS, PLUMB_BOB, Camera
from embodied_depth_trainer.camera_calibration.checks import Limits
from embodied_depth_trainer.camera_calibration.fit import Fit, fit
from embodied_depth_trainer.camera_calibration.uncertainty import CrossValidation, cross_validate
from embodied_depth_trainer.camera_calibration.views import Observations

AUTO = "auto"
# The plumb bob stays unless the fisheye predicts views that it has not seen better than this: images of most lenses
# fit both, and other programs know the plumb bob.
CLEARLY_BETTER = 0.99
# A model with this many times the residuals of the other does not describe the lens, and is not cross-validated.
HOPELESS = 3.0
# Cross-validation and covariance disagree from this ratio of their medians on. In 24 simulated calibrations with the
# right model it was 0.4 to 1.9, with the wrong one 0.8 to 24 (median 2.2 where the models differ by 0.04 pixels).
DISAGREEMENT = 2.0


@dataclass(frozen=True)
class Calibration:
    """A camera and what is known about its errors."""

    fit: Fit
    validated: CrossValidation
    held_out_px: dict[str, float]
    """Error of every model on views that it has not seen; infinite if the model does not fit at all."""
    choice: str
    """Why this model, as a sentence."""
    projected: Floats
    """Map of the uncertainty that follows from the noise of the corners, pixels."""
    crossed: Floats
    """Map of the same from cross-validation, pixels."""

    @property
    def camera(self) -> Camera:
        return self.fit.solution.camera

    @property
    def disagreement(self) -> float:
        """Median of the cross-validation over median of what noise explains."""
        return float(np.nanmedian(self.crossed) / max(float(np.nanmedian(self.projected)), 1e-12))

    @property
    def deviations(self) -> Floats:
        """Standard deviations of the intrinsics, enlarged where cross-validation finds more than noise explains."""
        deviations = np.sqrt(np.maximum(np.diag(self.fit.covariance), 0.0)) * max(1.0, self.disagreement)
        return np.asarray(deviations)

    @property
    def better_model(self) -> str | None:
        """The model that predicts unseen views clearly better than this one."""
        best = min(MODELS, key=lambda name: self.held_out_px[name])
        return best if self.held_out_px[best] < CLEARLY_BETTER * self.held_out_px[self.camera.model] else None

    @property
    def warnings(self) -> list[str]:
        return _warnings(self)


def calibrate(seen: Observations, model: str = AUTO, limits: Limits | None = None) -> Calibration:
    """The calibration, or an error that says what is wrong with the views."""
    bounds = limits or Limits()
    checks.require_views(seen, bounds)
    fits = {name: _fit(name, seen) for name in MODELS}
    # A model must not seem better because it has left out the corners that it cannot explain.
    used = np.any([found.used for found in fits.values() if found is not None], axis=0)
    if not used.any():
        raise checks.no_fit()
    least = min(found.noise_px for found in fits.values() if found is not None)
    validated = {
        name: cross_validate(found, used)
        for name, found in fits.items()
        if found is not None and (name == model or found.noise_px < HOPELESS * least)
    }
    errors = {name: validated[name].held_out_px if name in validated else np.inf for name in MODELS}
    chosen, choice = _choose(model, errors)
    found = fits[chosen]
    if found is None:
        raise checks.no_fit(chosen)
    checks.require_fit(found, bounds)
    own = validated[chosen] if np.array_equal(found.used, used) else cross_validate(found, found.used)
    calibration = _measured(found, own, errors, choice)
    checks.require_certainty(calibration.camera, calibration.deviations, calibration.better_model)
    return calibration


def _measured(found: Fit, validated: CrossValidation, errors: dict[str, float], choice: str) -> Calibration:
    camera = found.solution.camera
    try:
        return Calibration(
            found, validated, errors, choice, uncertainty.projected(found), validated.differences(camera)
        )
    except np.linalg.LinAlgError:
        # A calibration without some of the views projects to no finite place.
        raise checks.no_fit(camera.model) from None


def _fit(model: str, seen: Observations) -> Fit | None:
    """None where the model does not fit at all, as the plumb bob with views beyond 90 degrees."""
    try:
        found = fit(model, seen)
    except np.linalg.LinAlgError:
        return None
    sound = np.isfinite(found.solution.camera.values).all() and np.isfinite(found.residuals[found.used]).all()
    return found if sound and found.used.any() else None


def _choose(model: str, errors: dict[str, float]) -> tuple[str, str]:
    told = ", ".join(
        f"{name} {error:.3f} px" if np.isfinite(error) else f"{name} does not fit" for name, error in errors.items()
    )
    if model != AUTO:
        return model, f"The model is {model} because --model says so. Error on views that a fit has not seen: {told}."
    best = min(errors, key=lambda name: errors[name])
    chosen = best if errors[best] < CLEARLY_BETTER * errors[PLUMB_BOB] else PLUMB_BOB
    return chosen, f"The model is {chosen}. Error on views that a fit has not seen: {told}."


def _warnings(found: Calibration) -> list[str]:
    camera = found.camera
    warnings = []
    if found.disagreement > DISAGREEMENT:
        warnings.append(
            f"cross-validation finds {found.disagreement:.1f} times the error that the noise of the corners explains; "
            "the standard deviations are enlarged by that. The model does not fit the lens, the board is bent, or it "
            "moved: put the board on glass, hold it still, or try the other --model"
        )
    if found.better_model is not None:
        warnings.append(f"--model {found.better_model} predicts views that it has not seen better; leave --model out")
    lacking = float(np.mean(~np.isfinite(found.projected)))
    if lacking > 0:
        warnings.append(
            f"the model holds up to {np.degrees(camera.valid_angle()):.0f} degrees from the optical axis, so that "
            f"{lacking:.0%} of the image has no direction; take images with the board in the corners of the image"
        )
    return warnings + checks.coverage_warnings(found.fit)
