"""LiDAR odometry by KISS-ICP (the `kiss-icp` package), scan by scan: `kiss_icp_odometry.py VOXEL_M MAX_RANGE_M`.

On stdin, for each scan: the number of points as little-endian u32, then x and y of each as f32, metres, in the scanner's frame.
Prints `ready`, and for each scan a line with the seconds that it took and the pose in the frame of the first scan: x, y, yaw.
"""

import math
import struct
import sys
import time

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP


def main():
    config = KISSConfig()
    config.mapping.voxel_size = float(sys.argv[1])
    config.data.max_range = float(sys.argv[2])
    # Its correction of motion takes a scan to last until the next one. These last a quarter of that, in which the robot
    # moves by 5 mm.
    config.data.deskew = False
    # The robot's own localization has one thread.
    config.registration.max_num_threads = 1
    # Between two scans the robot moves centimetres. The default is for cars.
    config.adaptive_threshold.min_motion_th = 0.01
    config.adaptive_threshold.initial_threshold = 0.5
    odometry = KissICP(config)
    print("ready", flush=True)
    while header := sys.stdin.buffer.read(4):
        (count,) = struct.unpack("<I", header)
        flat = np.frombuffer(sys.stdin.buffer.read(8 * count), "<f4").reshape(-1, 2)
        points = np.zeros((count, 3))
        points[:, :2] = flat
        start = time.perf_counter()
        odometry.register_frame(points, np.empty(0))
        seconds = time.perf_counter() - start
        pose = odometry.last_pose
        print(seconds, pose[0, 3], pose[1, 3], math.atan2(pose[1, 0], pose[0, 0]), flush=True)


main()
