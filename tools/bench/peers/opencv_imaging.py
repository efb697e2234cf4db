#!/usr/bin/env python3
"""Peer of the image front end: OpenCV's conversion, remapping with fixed-point maps, and planes of floats."""

import sys
import time

import cv2
import numpy as np

WIDTH, HEIGHT = 640, 480
TARGET = (640, 192)
K = np.array([[420.0, 0, 321.0], [0, 420.0, 238.0], [0, 0, 1]])
LENS = np.array([-0.28, 0.07, 0.0004, -0.0003, 0.0])
TARGET_K = np.array([[400.0, 0, 319.5], [0, 400.0, 95.5], [0, 0, 1]])


def planes(rgb):
    """The fastest of three ways that were tried: planes of bytes first, then floats."""
    out = np.empty((3, TARGET[1], TARGET[0]), np.float32)
    for plane, byte in zip(out, cv2.split(rgb)):
        np.multiply(byte, np.float32(1 / 255), out=plane)
    return out


def main():
    cv2.setNumThreads(int(sys.argv[1]))
    folder = sys.argv[2]
    maps = cv2.initUndistortRectifyMap(K, LENS, np.eye(3), TARGET_K, TARGET, cv2.CV_16SC2)
    read = lambda name: np.fromfile(f"{folder}/{name}", np.uint8)
    yuyv = read("yuyv").reshape(HEIGHT, WIDTH, 2)
    nv12 = read("nv12").reshape(HEIGHT * 3 // 2, WIDTH)
    rgb = read("rgb8").reshape(HEIGHT, WIDTH, 3)
    jpeg = read("mjpeg")
    straighten = lambda picture: planes(cv2.remap(picture, *maps, interpolation=cv2.INTER_LINEAR))
    work = {
        "yuyv": lambda: straighten(cv2.cvtColor(yuyv, cv2.COLOR_YUV2RGB_YUYV)),
        "nv12": lambda: straighten(cv2.cvtColor(nv12, cv2.COLOR_YUV2RGB_NV12)),
        "rgb8": lambda: straighten(rgb),
        "mjpeg": lambda: straighten(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB)),
        "same": lambda: planes(rgb[144:336]),
    }
    print("ready", flush=True)
    for line in sys.stdin:
        start = time.perf_counter()
        work[line.strip()]()
        print(time.perf_counter() - start, flush=True)


if __name__ == "__main__":
    main()
