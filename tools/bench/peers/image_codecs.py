"""Size and single-core time of lossless codecs on real images (folders that contain rgb/). Prints rows of a table.

Needs `pip install imagecodecs numpy pillow`.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import imagecodecs as ic
import numpy as np
from PIL import Image

CODECS = {
    "zstd 1 of raw bytes": (lambda a: ic.zstd_encode(a.tobytes(), level=1), ic.zstd_decode),
    "QOI": (ic.qoi_encode, ic.qoi_decode),
    "PNG, level 1 (libpng)": (lambda a: ic.png_encode(a, level=1), ic.png_decode),
    "PNG, level 6 (libpng)": (lambda a: ic.png_encode(a, level=6), ic.png_decode),
    "JPEG-LS": (ic.jpegls_encode, ic.jpegls_decode),
    "WebP lossless, method 0": (lambda a: ic.webp_encode(a, lossless=True, method=0), ic.webp_decode),
    "JPEG XL lossless, effort 1": (
        lambda a: ic.jpegxl_encode(a, lossless=True, effort=1, numthreads=1),
        ic.jpegxl_decode,
    ),
    "JPEG XL lossless, effort 3": (
        lambda a: ic.jpegxl_encode(a, lossless=True, effort=3, numthreads=1),
        ic.jpegxl_decode,
    ),
}


def main() -> None:
    paths = [p for d in sys.argv[1:] for p in sorted(Path(d).glob("rgb/*"))[::7]][:60]
    images = [np.ascontiguousarray(np.asarray(Image.open(p).convert("RGB").resize((640, 480)))) for p in paths]
    print(f"{len(images)} images of 640x480")
    for name, (encode, decode) in CODECS.items():
        for a in images[:3]:
            encode(a)
        start = time.process_time()
        data = [encode(a) for a in images]
        middle = time.process_time()
        for d in data:
            decode(d)
        end = time.process_time()
        kib = np.mean([len(d) for d in data]) / 1024
        encode_ms = (middle - start) / len(data) * 1e3
        decode_ms = (end - middle) / len(data) * 1e3
        print(f"| {name} | {kib:.0f} | {kib * 1800 / 1024:.0f} | {encode_ms:.1f} | {decode_ms:.1f} | {encode_ms * 30 / 10:.0f} % |")


if __name__ == "__main__":
    main()
