#!/usr/bin/env python3
"""Peer of the image front end: OpenCV's conversion to RGB8 and undistortion with fixed-point maps."""

import sys
import time

import cv2
import numpy as np

WIDTH = 640
HEIGHT = 480
TARGET = (640, 192)
K = np.array([[420.0, 0, 321.0], [0, 420.0, 238.0], [0, 0, 1]])
LENS = np.array([-0.28, 0.07, 0.0004, -0.0003, 0.0])
TARGET_K = np.array([[400.0, 0, 319.5], [0, 400.0, 95.5], [0, 0, 1]])


def main():
    cv2.setNumThreads(int(sys.argv[1]))
    folder = sys.argv[2]
    maps = cv2.initUndistortRectifyMap(K, LENS, np.eye(3), TARGET_K, TARGET, cv2.CV_16SC2)
    # As our front end, every operation writes into memory that was allocated before.
    out = np.empty((TARGET[1], TARGET[0], 3), np.uint8)

    def read(name):
        return np.fromfile(f"{folder}/{name}", np.uint8)

    def undistort(rgb):
        cv2.remap(rgb, *maps, interpolation=cv2.INTER_LINEAR, dst=out)

    yuyv = read("yuyv").reshape(HEIGHT, WIDTH, 2)
    nv12 = read("nv12").reshape(HEIGHT * 3 // 2, WIDTH)
    rgb = read("rgb8").reshape(HEIGHT, WIDTH, 3)
    jpeg = read("mjpeg")
    converted = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    operations = {
        "yuyv": lambda: undistort(cv2.cvtColor(yuyv, cv2.COLOR_YUV2RGB_YUYV, dst=converted)),
        "nv12": lambda: undistort(cv2.cvtColor(nv12, cv2.COLOR_YUV2RGB_NV12, dst=converted)),
        "rgb8": lambda: undistort(rgb),
        "mjpeg": lambda: undistort(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB)),
        "crop": lambda: np.copyto(out, rgb[144:336]),
    }
    print("ready", flush=True)
    for line in sys.stdin:
        start = time.perf_counter()
        operations[line.strip()]()
        print(time.perf_counter() - start, flush=True)


if __name__ == "__main__":
    main()
