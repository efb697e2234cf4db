"""`embodied-depth calibrate`: calibrates the confidence of an exported student."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from embodied_depth_trainer.data.dataset import read_frames
from embodied_depth_trainer.export import calibration


def add_calibrate(command: argparse.ArgumentParser) -> None:
    command.add_argument("--model", type=Path, required=True, help="ONNX file of a student")
    for name in ("--recording", "--coarse", "--labels"):
        command.add_argument(name, type=Path, action="append", required=True, help="as for `train`; may be repeated")
    command.add_argument("--every", type=int, default=1, help="use every Nth frame [1]")
    command.add_argument("--out", type=Path, required=True, help="ONNX file to write")


def run_calibrate(options: argparse.Namespace) -> None:
    torch.set_num_threads(1)
    frames = read_frames(options.recording, options.coarse, [], None, options.labels, options.every)
    found, counts = calibration.calibrate(options.model, frames, options.out)
    print(f"{options.out}: from {len(frames)} frames, {calibration.table(counts, found)}")
