"""Replaces `firmware-host` in tests of the protocol: a walk through a synthetic room, on which every model that was
handed over leads elsewhere. `python -m tests.fake_robot explore|views ...`."""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from dataclasses import asdict
from pathlib import Path

import numpy as np

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.files import write_atomically

from .fake_engine import dump
from .recordings import write_segment
from .rooms import room

SIZE = (32, 64)


def explore(options: argparse.Namespace) -> None:
    options.out.mkdir(parents=True)
    handing_over = options.hand_over is not None
    ends = [*(range(options.first, options.frames, options.every) if handing_over else []), options.frames]
    seed = options.seed
    begin = 0
    for segment, end in enumerate(ends):
        frames = walk(seed, begin, end)
        write_segment(options.out / f"recording_{segment:04d}.mcap", frames, wheels(frames), segment)
        if options.dump is not None:
            dump(options.dump, frames, begin)
        if end == options.frames:
            break
        request = {"round": segment, "frames": end, "segments": segment + 1, "digest": f"{seed}"}
        write_atomically(json.dumps(request).encode(), options.hand_over / f"round_{segment:04d}.json")
        model = options.hand_over / f"model_{segment:04d}.onnx"
        while not model.exists():
            time.sleep(0.01)
        seed = zlib.crc32(model.read_bytes())
        begin = end
    summary = {"end_reason": "frame_budget", "digest": f"{seed}", "coverage": 0.5}
    # Like the robot: the loop, which waits for this file, must never read a part of it.
    write_atomically(json.dumps(summary).encode(), options.out / "summary.json")


def wheels(frames: Frames) -> list[dict[str, float]]:
    """Poses of the base; the camera points ahead from 0.1 m in front of its centre."""
    found = []
    for pose in frames.t_world_camera:
        yaw = -np.arctan2(pose[0, 2], pose[2, 2])
        x_m = pose[2, 3] - 0.1 * np.cos(yaw)
        y_m = -pose[0, 3] - 0.1 * np.sin(yaw)
        found.append({"x_m": float(x_m), "y_m": float(y_m), "yaw_rad": float(yaw)})
    return found


def walk(seed: int, begin: int, end: int) -> Frames:
    frames = room(end - begin, SIZE, seed)
    return Frames(**{**vars(frames), "time_ns": frames.time_ns + begin * 100_000_000})


def views(options: argparse.Namespace) -> None:
    options.out.mkdir(parents=True)
    frames = room(options.count, SIZE, options.seed)
    assert frames.truth_mm is not None
    assert frames.coarse is not None
    assert frames.dense is not None
    entries = []
    for index in range(options.count):
        rotated = index % 4 == 3
        name = f"{index:06}"
        np.save(options.out / f"{name}_rgb.npy", frames.rgb[index])
        np.save(options.out / f"{name}_truth.npy", frames.truth_mm[index])
        np.save(options.out / f"{name}.npy", frames.coarse[index])
        np.save(options.out / f"{name}_dense.npy", frames.dense[index])
        pose = frames.t_world_camera[index].ravel().tolist()
        entry = {"name": name, "time_ns": index, "t_world_camera": pose, "rgb": True, "truth": True}
        entries.append({**entry, "coarse": not rotated, "dense": True, "approach": "turn" if rotated else "drive"})
    index_ = {"format_version": 1, **asdict(frames.camera), "frames": entries}
    (options.out / "dump.json").write_text(json.dumps(index_))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("command", choices=("explore", "views"))
    for name in ("--scene", "--policy", "--config"):
        parser.add_argument(name)
    for name in ("--seed", "--frames", "--first", "--every", "--count"):
        parser.add_argument(name, type=int)
    for name in ("--out", "--hand-over", "--dump"):
        parser.add_argument(name, type=Path)
    options = parser.parse_args()
    if options.scene == "nowhere":
        sys.exit("error: scene `nowhere` does not exist")
    if options.command == "explore":
        explore(options)
    else:
        views(options)


if __name__ == "__main__":
    main()
