"""`embodied-depth prepare`: makes of recorded segments what trainings read."""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path

from embodied_depth_trainer.cluster import LOCAL
from embodied_depth_trainer.commands.arguments import (
    add_cluster,
    add_firmware_host,
    add_robots,
    image_size,
    known_robots,
    source,
    with_absolute_paths,
)
from embodied_depth_trainer.data.past_frames import GAP, PastFrames
from embodied_depth_trainer.data.teacher import Teacher
from embodied_depth_trainer.data.teacher_options import MEAN, MULTIPLE, STD, TeacherOptions
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.parts import Part
from embodied_depth_trainer.store.prepare import Report, Tools, prepare, prepare_part, prune, remove_damaged
from embodied_depth_trainer.store.recipe import RESTART_EVERY, Coarse, Recipe, engine_of
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.studies.robot import find_firmware_host

# As `firmware-host perceive` takes it.
LONGEST_RESTART = 10_000


def part(text: str) -> Part:
    """Parses `2/8`: the second of eight parts."""
    try:
        number, count = (int(word) for word in text.split("/"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not a part such as 2/8 (the second of eight)") from None
    if not 1 <= number <= count:
        raise argparse.ArgumentTypeError(f"there is no part `{text}`; parts are counted from 1 to their number")
    return Part(number, count)


def add_prepare(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "source",
        type=source,
        nargs="+",
        help="--out directory of a run, a directory that holds runs at any depth, or the URL of either in an object "
        "store (s3://BUCKET/PREFIX, gs://BUCKET/PREFIX)",
    )
    command.add_argument("--out", type=Path, required=True, help="the store: a directory to make or to complete")
    command.add_argument("--workers", type=int, help="number of processes of this computer [1]")
    add_cluster(command, "segments are prepared, one for each CPU;")
    command.add_argument(
        "--part",
        type=part,
        metavar="K/N",
        help="make only the shards of part K of N, safely beside the other parts (`tools/trainer/jobs`); the same "
        "command without --part then lists all shards and makes labels [all segments]",
    )
    command.add_argument("--size", type=image_size, help="reduce the images to rows x columns [as recorded]")
    command.add_argument(
        "--coarse",
        choices=("robot", "none"),
        default="robot",
        help="coarse depth by the robot's own engine, or none, for networks without it [robot]",
    )
    command.add_argument(
        "--past-frames",
        type=int,
        choices=(1, 2),
        help="compute coarse depth from this many past frames instead, as the paper does",
    )
    command.add_argument("--past-gap", type=int, default=GAP, help=f"frames between two past frames [{GAP}]")
    command.add_argument(
        "--restart-every",
        type=int,
        default=RESTART_EVERY,
        metavar="FRAMES",
        help="dense depth of every second stretch of this many frames is that of a robot that starts with the stretch, "
        f"so that networks learn what to do without memory; 0: never [{RESTART_EVERY}]",
    )
    command.add_argument("--no-labels", action="store_true", help="compute no labels")
    command.add_argument(
        "--check", action="store_true", help="first compare all digests, and make what is damaged again"
    )
    command.add_argument(
        "--prune", action="store_true", help="afterwards, remove shards and labels that are not used any more"
    )
    add_robots(command)
    add_firmware_host(command)
    _add_teacher(command)


def _add_teacher(command: argparse.ArgumentParser) -> None:
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


def tools_of(options: argparse.Namespace) -> Tools:
    """The recipe that the options ask for, and what it needs."""
    past = PastFrames(options.past_frames, options.past_gap) if options.past_frames else None
    coarse: Coarse = "past frames" if past is not None else options.coarse
    robot = find_firmware_host(options.firmware_host) if coarse == "robot" else None
    has_labels = coarse != "none" and not options.no_labels
    teacher_options = _teacher_options(options) if options.teacher is not None else None
    digest = None
    if teacher_options is not None:
        if not has_labels:
            raise TrainerError("--teacher adds to labels, and none are computed; omit --no-labels and --coarse none")
        # A file that cannot be used is reported before anything is computed.
        Teacher(options.teacher, teacher_options)
        digest = hashlib.sha256(options.teacher.read_bytes()).hexdigest()
    if not 0 <= options.restart_every <= LONGEST_RESTART:
        raise TrainerError(f"--restart-every {options.restart_every} is not within 0 to {LONGEST_RESTART} frames")
    has_restarts = robot is not None and options.restart_every > 0
    recipe = Recipe(
        coarse,
        engine_of(robot) if robot else None,
        past,
        options.size,
        has_labels,
        digest,
        teacher_options,
        restart_every=options.restart_every if has_restarts else None,
    )
    if options.workers is not None and options.on != LOCAL:
        raise TrainerError(
            "--workers counts processes of this computer, and a Ray cluster uses all its CPUs; omit --workers"
        )
    workers = 1 if options.workers is None else options.workers
    return Tools(recipe, robot, options.teacher, teacher_options, workers, known_robots(options), options.on)


def _teacher_options(options: argparse.Namespace) -> TeacherOptions:
    return TeacherOptions(
        options.teacher_output,
        options.teacher_size,
        options.teacher_multiple,
        tuple(options.teacher_mean),
        tuple(options.teacher_std),
    )


def run_prepare(options: argparse.Namespace) -> None:
    if options.part is not None:
        run_part(options)
        return
    options = options if options.on == LOCAL else with_absolute_paths(options)
    tools = tools_of(options)
    store = Store.create(options.out, tools.recipe)
    for problem in remove_damaged(store) if options.check else ():
        print(f"made again: {problem}", file=sys.stderr)
    report = prepare(options.source, store, tools)
    print_problems(report)
    print(
        f"{options.out}: {store.frames} frames; {report.segments} segments were new, "
        f"{report.labelled} have new labels, {len(report.damaged)} of the new ones are damaged"
    )
    if tools.known_robots is not None and report.signed_by:
        counts = (f"{count} of {tools.known_robots.label(key)}" for key, count in report.signed_by.items())
        print(f"signed: {', '.join(counts)}")
    if store.refused:
        print(f"refused segments in the store, which no known robot signed: {store.refused}")
    if options.prune:
        print(f"{prune(store)} unused shards, labels and pairs were removed")
    if store.frames == 0 and options.robots is not None and store.refused:
        raise TrainerError(
            f"no segment is signed by a robot of {options.robots}; add the public keys of the robots that you trust"
        )
    if store.frames == 0:
        raise TrainerError(f"no frame was found in {', '.join(map(str, options.source))}; record a run first")


def run_part(options: argparse.Namespace) -> None:
    """Makes a part of the shards."""
    if options.on != LOCAL:
        raise TrainerError("a Ray cluster divides the segments itself; give --on or --part")
    if options.check or options.prune:
        # --prune would remove the shards of all parts, because no list names them yet.
        raise TrainerError("--check and --prune are of a whole store; give them to the `prepare` without --part")
    tools = tools_of(options)
    report = prepare_part(options.source, Store.create(options.out, tools.recipe), tools, options.part)
    print_problems(report)
    print(
        f"{options.out}: part {options.part}: {report.segments} segments were read, {len(report.damaged)} of them are "
        "damaged; after all parts, the same command without --part lists their shards"
    )


def print_problems(report: Report) -> None:
    for file, why in report.damaged.items():
        print(f"{file}: {why}", file=sys.stderr)
    for file, why in report.refused.items():
        print(f"{file}: refused: {why}", file=sys.stderr)
    for line in report.breaks:
        print(f"warning: {line}", file=sys.stderr)
    for name in report.replaced:
        print(f"{name} was replaced while it was read; prepare it again", file=sys.stderr)
