"""Recorded images: PNG files of 8-bit RGB."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

# Larger images come from corrupt headers, not from a camera of this robot.
MAX_PIXELS = 64_000_000
# Of the chunk IHDR, which every PNG begins with: width, height, bits of a sample, kind of pixels.
_HEAD = struct.Struct(">8x4x4sIIBB")
_RGB = 2


@dataclass(frozen=True)
class RgbPng:
    """An image whose bytes are as they were recorded."""

    data: bytes
    width: int
    height: int

    @staticmethod
    def of(data: bytes) -> RgbPng:
        """Raises a `ValueError` for what the robot does not record."""
        if not data.startswith(b"\x89PNG") or len(data) < _HEAD.size:
            raise ValueError("it is no PNG")
        chunk, width, height, bits, kind = _HEAD.unpack_from(data)
        if (chunk, bits, kind) != (b"IHDR", 8, _RGB):
            raise ValueError(f"a PNG with {bits} bits of kind {kind}, not 8-bit RGB")
        if width * height > MAX_PIXELS:
            raise ValueError(f"a {width}x{height} PNG is larger than {MAX_PIXELS} pixels")
        return RgbPng(data, width, height)

    def pixels(self) -> NDArray[np.uint8]:
        """[height, width, 3]. Raises an `OSError` for a PNG that is damaged."""
        # The number of pixels was checked.
        with Image.open(io.BytesIO(self.data), formats=["PNG"]) as image:
            return np.asarray(image)
