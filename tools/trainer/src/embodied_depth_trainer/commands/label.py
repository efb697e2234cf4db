"""`embodied-depth label`: computes depth labels from a whole recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from embodied_depth_trainer.data.dataset import read_frames
from embodied_depth_trainer.data.labels import write_labels


def add_label(command: argparse.ArgumentParser) -> None:
    command.add_argument("--recording", type=Path, required=True, help="--out directory of a run")
    command.add_argument(
        "--coarse", type=Path, required=True, help="dump of the same run by `firmware-host perceive --dump`"
    )
    command.add_argument("--out", type=Path, required=True, help="file to write (.npz)")


def run_label(options: argparse.Namespace) -> None:
    frames = read_frames([options.recording], [options.coarse], [], None)
    share = write_labels(frames, options.out)
    print(f"{options.out}: {len(frames)} frames, labels for {share:.0%} of their cells")
