"""OpenCV's DISOpticalFlow on two pictures in files: FROM TO WIDTH HEIGHT (raw bytes, one a pixel).

Every line on stdin is a preset (`ultra_fast`, `fast`, `medium`): computes its flow and prints the seconds.
`save PRESET FILE` writes the flow as raw little-endian f32 pairs and prints `saved`.
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
    width, height = int(sys.argv[3]), int(sys.argv[4])
    pictures = [np.fromfile(name, np.uint8).reshape(height, width) for name in sys.argv[1:3]]
    cv2.setNumThreads(int(os.environ.get("RAYON_NUM_THREADS", "0")) or os.cpu_count())
    engines = {name: cv2.DISOpticalFlow_create(preset) for name, preset in PRESETS.items()}
    print("ready", flush=True)
    for line in sys.stdin:
        words = line.split()
        if words[0] == "save":
            engines[words[1]].calc(*pictures, None).astype("<f4").tofile(words[2])
            print("saved", flush=True)
            continue
        began = time.perf_counter()
        engines[words[0]].calc(*pictures, None)
        print(time.perf_counter() - began, flush=True)


main()
