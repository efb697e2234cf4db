"""Types of arrays that the calibration of the camera shares."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int64]
Flags: TypeAlias = NDArray[np.bool_]
# What OpenCV and its type information call an image: rows x columns, or rows x columns x channels, of bytes.
Image: TypeAlias = NDArray[Any]
