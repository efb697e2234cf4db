"""OpenCV's semi-global matching of two rectified images in files: LEFT RIGHT WIDTH HEIGHT (raw bytes, one per pixel).

Every line on stdin is an operation: `full` matches the images, `quarter` the images at a quarter of their width and height. Both
compute 64 disparities over three paths, OpenCV's fastest mode. The answer is the time in seconds.
"""

import os
import sys
import time

import cv2
import numpy as np

BLOCK = 5
REDUCTION = 4


def main():
    width, height = int(sys.argv[3]), int(sys.argv[4])
    full = [np.fromfile(name, np.uint8).reshape(height, width) for name in sys.argv[1:3]]
    size = (width // REDUCTION, height // REDUCTION)
    pairs = {"full": full, "quarter": [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in full]}
    cv2.setNumThreads(int(os.environ.get("RAYON_NUM_THREADS", "0")) or os.cpu_count())
    # Penalties as OpenCV's documentation recommends them for one channel.
    mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY
    engine = cv2.StereoSGBM_create(0, 64, BLOCK, 8 * BLOCK**2, 32 * BLOCK**2, 1, uniquenessRatio=10, mode=mode)
    print("ready", flush=True)
    for line in sys.stdin:
        pair = pairs[line.strip()]
        began = time.perf_counter()
        engine.compute(*pair)
        print(time.perf_counter() - began, flush=True)


main()
