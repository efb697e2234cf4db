"""OpenCV's DIS optical flow on pairs of gray images: `opencv_dis.py FOLDER PAIRS WIDTH HEIGHT`.

Pair N is `FOLDER/N_first` and `FOLDER/N_second`, raw bytes. Every line on stdin is a preset (`ultra_fast`, `fast`,
`medium`): computes the flow of pair 0 and prints the seconds. `save PRESET N FILE` writes the flow of pair N as raw
little-endian f32 pairs and prints `saved`.
"""

import os
import sys
import time

import cv2
import numpy as np

PRESETS = {
    "ultra_fast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}


def main():
    folder = sys.argv[1]
    count, width, height = map(int, sys.argv[2:5])

    def image(pair, which):
        return np.fromfile(f"{folder}/{pair}_{which}", np.uint8).reshape(height, width)

    pairs = [(image(pair, "first"), image(pair, "second")) for pair in range(count)]
    cv2.setNumThreads(int(os.environ.get("RAYON_NUM_THREADS", "0")) or os.cpu_count())
    engines = {name: cv2.DISOpticalFlow_create(preset) for name, preset in PRESETS.items()}
    print("ready", flush=True)
    for line in sys.stdin:
        words = line.split()
        if words[0] == "save":
            engines[words[1]].calc(*pairs[int(words[2])], None).astype("<f4").tofile(words[3])
            print("saved", flush=True)
            continue
        start = time.perf_counter()
        engines[words[0]].calc(*pairs[0], None)
        print(time.perf_counter() - start, flush=True)


main()
