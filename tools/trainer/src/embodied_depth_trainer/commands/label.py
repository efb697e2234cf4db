"""`embodied-depth label`: computes depth labels from a whole recording, optionally with a monocular teacher."""

from __future__ import annotations

import argparse
from pathlib import Path

from tqdm import tqdm

from embodied_depth_trainer.commands.arguments import image_size
from embodied_depth_trainer.data.dataset import read_frames
from embodied_depth_trainer.data.labels import labels, save_labels
from embodied_depth_trainer.data.teacher import MEAN, MULTIPLE, STD, Teacher, TeacherOptions, teach


def add_label(command: argparse.ArgumentParser) -> None:
    command.add_argument("--recording", type=Path, required=True, help="--out directory of a run")
    command.add_argument(
        "--coarse", type=Path, required=True, help="dump of the same run by `firmware-host perceive --dump`"
    )
    command.add_argument("--out", type=Path, required=True, help="file to write (.npz)")
    teacher = command.add_argument_group("teacher", "a monocular depth network for cells without a label")
    teacher.add_argument("--teacher", type=Path, metavar="FILE", help="ONNX file with one image as input [none]")
    teacher.add_argument(
        "--teacher-output",
        choices=("inverse", "depth"),
        default="inverse",
        help="what it returns: inverse depth as Depth Anything and MiDaS, or depth as metric networks do [inverse]",
    )
    teacher.add_argument(
        "--teacher-size",
        type=image_size,
        help="rows x columns of its input [those of the file, else those of the images, rounded up]",
    )
    teacher.add_argument(
        "--teacher-multiple", type=int, default=MULTIPLE, help=f"its sizes are multiples of this [{MULTIPLE}]"
    )
    for name, default in (("mean", MEAN), ("std", STD)):
        teacher.add_argument(
            f"--teacher-{name}",
            type=float,
            nargs=3,
            default=default,
            metavar=("R", "G", "B"),
            help=f"normalisation of its input, colours in 0..1 [{' '.join(map(str, default))}, as ImageNet]",
        )


def run_label(options: argparse.Namespace) -> None:
    teacher = None
    if options.teacher is not None:
        # A file that cannot be used is reported before the labels are computed.
        teacher = Teacher(
            options.teacher,
            TeacherOptions(
                options.teacher_output,
                options.teacher_size,
                options.teacher_multiple,
                tuple(options.teacher_mean),
                tuple(options.teacher_std),
            ),
        )
    frames = read_frames([options.recording], [options.coarse], [], None)
    planes = labels(frames)
    if teacher is not None:
        with tqdm(total=len(frames), unit="frame", disable=None) as bar:
            planes, taught = teach(frames, planes, teacher, bar.update)
        print(
            f"the teacher agrees with {taught.agreeing:.0%} of the labels in {taught.frames} of {len(frames)} frames "
            f"and is not used in the others; {taught.before:.0%} of the cells have a label without it"
        )
    share = save_labels(frames, planes, options.out)
    print(f"{options.out}: {len(frames)} frames, labels for {share:.0%} of their cells")
