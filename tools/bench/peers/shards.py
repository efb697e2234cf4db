#!/usr/bin/env python3
"""Reading of shards beside reading the same recording into memory, as `loop` and `evaluate` do; and `prepare`.

    python shards.py FIRMWARE_HOST RUN WORK [RUNS]

Prints a table of medians. Seconds are processor time, so other programs matter less. Every measurement is made by a
process of its own, and the two ways alternate. Neither has labels, which a recording in memory lacks.
"""

from __future__ import annotations

import json
import resource
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch
from embodied_depth_trainer.data.batches import make_batch
from embodied_depth_trainer.data.dataset import find_pairs as find_in_memory
from embodied_depth_trainer.data.dataset import read_frames
from embodied_depth_trainer.data.frame_set import FrameSet
from embodied_depth_trainer.data.pairs import PairRule, Pairs
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.prepare import Tools, prepare
from embodied_depth_trainer.store.recipe import Recipe, engine_of
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer

SETTINGS = Settings("student", batch=8, crop_width=320)
# Batches that are drawn to measure memory, and steps that are timed after the first one.
BATCHES = 20
STEPS = 8
RUNS = 3


def processor_s() -> float:
    """Processor time of this process and of those that it has run."""
    return sum(resource.getrusage(who).ru_utime + resource.getrusage(who).ru_stime for who in (0, -1))


def memory_mib(field: str) -> float:
    """Resident memory of this process: now (`VmRSS`), or the most since the last `forget_peak` (`VmHWM`)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith(f"{field}:"))
    return float(line.split()[1]) / 1024


def forget_peak() -> None:
    """Makes the kernel measure the most memory from now on; starting Python and PyTorch has used more."""
    Path("/proc/self/clear_refs").write_text("5")


def read(way: str, run: Path, work: Path) -> tuple[FrameSet, Pairs]:
    """The frames and pairs of the run."""
    if way == "shards":
        dataset = open_dataset([Store(work / "store")])
        return dataset.frames, find_pairs(dataset, None, PairRule())[0]
    frames = read_frames([run], [work / "dump"], [], None)
    return frames, find_in_memory(frames, None, PairRule())[0]


def training(way: str, run: Path, work: Path) -> dict[str, float]:
    """A training up to its first step, and some steps more."""
    torch.set_num_threads(1)
    start = processor_s()
    frames, pairs = read(way, run, work)
    trainer = Trainer(frames, pairs, SETTINGS)
    trainer.advance()
    first = processor_s()
    for _ in range(STEPS):
        trainer.advance()
    return {"first_step_s": first - start, "samples_per_s": STEPS * SETTINGS.batch / (processor_s() - first)}


def reading(way: str, run: Path, work: Path) -> dict[str, float]:
    """The memory of the frames and of drawing batches."""
    forget_peak()
    program = memory_mib("VmRSS")
    frames, pairs = read(way, run, work)
    for step in range(BATCHES):
        random = np.random.default_rng(step)
        make_batch(frames, *pairs.sample(SETTINGS.batch, random), SETTINGS.depth_range_m, random, "cpu")
    return {"memory_mib": memory_mib("VmHWM") - program}


def preparing(robot: Path, run: Path, store: Path) -> dict[str, float]:
    """All of `prepare`, with labels, by one process."""
    recipe = Recipe("robot", engine_of(robot))
    start = processor_s()
    opened = Store.create(store, recipe)
    prepare([run], opened, Tools(recipe, robot))
    return {"frames_per_s": opened.frames / (processor_s() - start)}


def without_labels(robot: Path, run: Path, work: Path) -> None:
    """The store and the dump of coarse depth that the measurements read."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    recipe = Recipe("robot", engine_of(robot), labels=False)
    prepare([run], Store.create(work / "store", recipe), Tools(recipe, robot))
    command = [str(robot), "perceive", "--recording", str(run), "--out", str(work / "look"), "--dump"]
    subprocess.run([*command, str(work / "dump")], check=True, stdout=subprocess.DEVNULL)
    # The pairs of shards are kept; the first training finds them.
    read("shards", run, work)


def measured(*arguments: object) -> dict[str, float]:
    """What a new process measures."""
    command = [sys.executable, __file__, *map(str, arguments)]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    found: dict[str, float] = json.loads(output.splitlines()[-1])
    return found


def table(robot: Path, run: Path, work: Path, runs: int) -> None:
    without_labels(robot, run, work)
    found: dict[tuple[str, str], list[float]] = {}
    for _ in range(runs):
        for way in ("shards", "memory"):
            for part in ("training", "reading"):
                for name, value in measured(part, way, run, work).items():
                    found.setdefault((way, name), []).append(value)
        shutil.rmtree(work / "prepared", ignore_errors=True)
        rate = measured("preparing", robot, run, work / "prepared")["frames_per_s"]
        found.setdefault(("shards", "frames_per_s"), []).append(rate)
    print("| what | shards | the recording in memory | shards / memory |")
    print("|---|---|---|---|")
    for name, what in ROWS.items():
        shards = statistics.median(found["shards", name])
        memory = statistics.median(found["memory", name]) if ("memory", name) in found else None
        cells = [what, f"{shards:.3g}", *(["", ""] if memory is None else [f"{memory:.3g}", f"{shards / memory:.2g}"])]
        print(f"| {' | '.join(cells)} |")


ROWS = {
    "first_step_s": "processor time from the start to the end of the first step, s",
    "samples_per_s": "samples per second of processor time (`student`, batch 8, strips of 320 columns)",
    "memory_mib": f"memory of reading {BATCHES} batches, above that of the program, MiB",
    "frames_per_s": "`prepare`: frames per second of one core, with coarse depth and labels",
}


def main() -> None:
    first, *rest = sys.argv[1:]
    if first in ("training", "reading"):
        way, run, work = rest
        work_of = training if first == "training" else reading
        print(json.dumps(work_of(way, Path(run), Path(work))))
    elif first == "preparing":
        print(json.dumps(preparing(*map(Path, rest))))
    else:
        run, work, *runs = rest
        table(Path(first), Path(run), Path(work), int(runs[0]) if runs else RUNS)


if __name__ == "__main__":
    main()
