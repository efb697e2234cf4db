"""`embodied-depth calibrate`: calibrates the confidence of an exported student."""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from embodied_depth_trainer.commands.arguments import add_stores, opened_stores
from embodied_depth_trainer.export import calibration
from embodied_depth_trainer.store.dataset import open_dataset


def add_calibrate(command: argparse.ArgumentParser) -> None:
    command.add_argument("--model", type=Path, required=True, help="ONNX file of a student")
    add_stores(command)
    command.add_argument("--out", type=Path, required=True, help="ONNX file to write")


def run_calibrate(options: argparse.Namespace) -> None:
    torch.set_num_threads(1)
    dataset = open_dataset(opened_stores(options), every=options.every)
    found, counts = calibration.calibrate(options.model, dataset.frames, options.out, dataset.summary)
    print(f"{options.out}: from {len(dataset.frames)} frames, {calibration.table(counts, found)}")
