"""OpenCV's semi-global matching of two rectified images in files: LEFT RIGHT WIDTH HEIGHT (raw bytes, one per pixel).

For every `one_pass` on stdin, computes 64 disparities over three paths, its fastest mode, and prints the seconds.
"""

import os
import sys
import time

import cv2
import numpy as np

BLOCK = 5


def main():
    width = int(sys.argv[3])
    height = int(sys.argv[4])
    left, right = (np.fromfile(name, np.uint8).reshape(height, width) for name in sys.argv[1:3])
    cv2.setNumThreads(int(os.environ.get("RAYON_NUM_THREADS", "0")) or os.cpu_count())
    # P1 and P2 as OpenCV's documentation recommends for one channel.
    one_pass = cv2.STEREO_SGBM_MODE_SGBM_3WAY
    engine = cv2.StereoSGBM_create(0, 64, BLOCK, 8 * BLOCK**2, 32 * BLOCK**2, 1, uniquenessRatio=10, mode=one_pass)
    print("ready", flush=True)
    for _ in sys.stdin:
        start = time.perf_counter()
        engine.compute(left, right)
        print(time.perf_counter() - start, flush=True)


main()
