#!/usr/bin/env python3
"""The image front end with OpenCV, for comparison: conversion, remapping with fixed-point maps, and planes of floats.
"""

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


def planes(rgb):
    """The fastest of three tried methods: planes of bytes first, then floats."""
    out = np.empty((3, TARGET[1], TARGET[0]), np.float32)
    for plane, byte in zip(out, cv2.split(rgb)):
        np.multiply(byte, np.float32(1 / 255), out=plane)
    return out


def read(folder, name):
    return np.fromfile(f"{folder}/{name}", np.uint8)


def main():
    cv2.setNumThreads(int(sys.argv[1]))
    folder = sys.argv[2]
    maps = cv2.initUndistortRectifyMap(K, LENS, np.eye(3), TARGET_K, TARGET, cv2.CV_16SC2)
    yuyv = read(folder, "yuyv").reshape(HEIGHT, WIDTH, 2)
    nv12 = read(folder, "nv12").reshape(HEIGHT * 3 // 2, WIDTH)
    rgb = read(folder, "rgb8").reshape(HEIGHT, WIDTH, 3)
    jpeg = read(folder, "mjpeg")

    def rectify(rgb):
        return planes(cv2.remap(rgb, *maps, interpolation=cv2.INTER_LINEAR))

    work = {
        "yuyv": lambda: rectify(cv2.cvtColor(yuyv, cv2.COLOR_YUV2RGB_YUYV)),
        "nv12": lambda: rectify(cv2.cvtColor(nv12, cv2.COLOR_YUV2RGB_NV12)),
        "rgb8": lambda: rectify(rgb),
        "mjpeg": lambda: rectify(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB)),
        "same": lambda: planes(rgb[144:336]),
    }
    print("ready", flush=True)
    for line in sys.stdin:
        start = time.perf_counter()
        work[line.strip()]()
        print(time.perf_counter() - start, flush=True)


if __name__ == "__main__":
    main()
