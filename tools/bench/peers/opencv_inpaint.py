"""OpenCV's inpainting of the holes of a depth image: WIDTH HEIGHT.

Every line on stdin is one image: `fill` fills 30 % of it, blocks of 32x32 pixels, as Telea (2004) describes. It is what depth
cameras' images are usually completed with. The answer is the time in seconds.
"""

import os
import sys
import time

import cv2
import numpy as np

BLOCK = 32
SHARE = 0.3
RADIUS = 3


def main():
    width, height = int(sys.argv[1]), int(sys.argv[2])
    random = np.random.default_rng(1)
    blocks = random.random((height // BLOCK, width // BLOCK)) < SHARE
    holes = np.kron(blocks, np.ones((BLOCK, BLOCK))).astype(np.uint8)
    ramp = np.linspace(40, 200, width, dtype=np.uint8)
    depth = np.broadcast_to(ramp, (height, width)).copy()
    cv2.setNumThreads(int(os.environ.get("RAYON_NUM_THREADS", "0")) or os.cpu_count())
    print("ready", flush=True)
    for _ in sys.stdin:
        began = time.perf_counter()
        cv2.inpaint(depth, holes, RADIUS, cv2.INPAINT_TELEA)
        print(time.perf_counter() - began, flush=True)


main()
