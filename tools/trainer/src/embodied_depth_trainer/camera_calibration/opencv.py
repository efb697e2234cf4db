"""OpenCV, which is an extra: only images need it, not the import of another program's calibration."""

from __future__ import annotations

from types import ModuleType

from embodied_depth_trainer.errors import TrainerError


def opencv() -> ModuleType:
    """The module `cv2` with the detector of boards."""
    try:
        import cv2
    except ImportError:
        raise TrainerError('calibrate-camera needs OpenCV: pip install -e "tools/trainer[calibrate-camera]"') from None
    if not hasattr(cv2, "aruco") or not hasattr(cv2.aruco, "CharucoDetector"):
        raise TrainerError(
            f"OpenCV {cv2.__version__} has no detector of ChArUco boards; install opencv-python-headless 4.8 or later"
        )
    return cv2
