"""`embodied-depth make-default`: makes the robot's default network from runs through simulated homes.

The steps are exploration, coarse depth, labels, training, calibration and export. Existing results are kept, so an
interrupted recipe continues. Homes with seeds below 10 are reserved for the demo, the README and the model card. No
run records ground truth.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from embodied_depth_trainer.commands.arguments import add_amp, add_device, add_init
from embodied_depth_trainer.commands.export import report_parity
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.calibration import calibrate, table
from embodied_depth_trainer.export.depth import export_checkpoint
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.store.dataset import Dataset, open_dataset, record_version
from embodied_depth_trainer.store.pair_index import find_pairs
from embodied_depth_trainer.store.prepare import Tools, prepare
from embodied_depth_trainer.store.recipe import RESTART_EVERY, Recipe, engine_of
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.training.initial import chosen
from embodied_depth_trainer.training.progress import Progress, draw
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

# Many homes with few frames each: what differs between homes and mounts matters more than how often one is seen.
FRAMES = 300
CALIBRATION_FRAMES = 300
# Neighbouring frames 3 cm apart add little.
EVERY = 2
# On top of the steps of the network that --init names.
STEPS = 4000
DECAY_STEPS = 2667
SETTINGS = Settings(
    network="student",
    batch=8,
    learning_rate=1e-3,
    decay=(STEPS - DECAY_STEPS, STEPS),
    crop_width=320,
    # Labels contain what coarse depth and the colours of two neighbours would teach, and more, at a quarter of the
    # time.
    photometric_weight=0.0,
    # Labels are missing where no motion has shown anything, as on blank walls: there, the network should leave dense
    # depth as it is. Alone, on views of the AWS house, .895 of all pixels were right with 0.4, .891 with 0.1 and the
    # same colours, .884 with 0.1 and the colours of the paper's code.
    coarse_weight=0.4,
    color_change=0.5,
    label_weight=1.0,
    uncertainty_weight=0.1,
    given_depth="dense",
)
# A camera with automatic exposure under lamps and sun (keys of robot.default.toml).
ROUGH = """\
[simulator.nuisances]
exposure_drift_stops = 0.7
flicker = 0.1
sun_patches = 1.0
sensor_noise = 3.0
"""


@dataclass(frozen=True)
class Mount:
    """Where the camera is."""

    pitch_down_deg: float
    height_m: float

    def toml(self) -> str:
        return f"[camera]\npitch_down_deg = {self.pitch_down_deg}\nheight_m = {self.height_m}\n"


DEFAULT = Mount(16.0, 0.8)
LEVEL = Mount(0.0, 0.8)


@dataclass(frozen=True)
class Run:
    """One walk through one home."""

    home: str
    policy: str
    mount: Mount = DEFAULT
    rough: bool = False

    @property
    def folder(self) -> str:
        return self.home.replace("?", "_").replace("&", "_").replace("=", "")

    def toml(self) -> str:
        return self.mount.toml() + (ROUGH if self.rough else "")


def _runs(count: int) -> tuple[Run, ...]:
    """Walks through `count` homes of each kind. The lengths of the lists have no common divisor, so that kinds of
    homes, policies, mounts and textures do not always occur together. Half of the cameras are the default one."""
    policies = ("active", "frontier", "active", "forward", "frontier", "active", "heuristic")
    mounts = (DEFAULT, LEVEL, DEFAULT, Mount(8.0, 0.6), DEFAULT, Mount(22.0, 1.1), DEFAULT, Mount(12.0, 0.35))
    textures = ("", "&texture=0.1", "", "&texture=0.5", "&texture=0.8")
    runs: list[Run] = []
    for seed in range(11, 11 + count):
        for kind in ("apartment", "house", "office"):
            at = len(runs)
            home = f"{kind}?seed={seed}{textures[at % len(textures)]}"
            policy = policies[at % len(policies)]
            runs.append(Run(home, policy, mounts[at % len(mounts)], rough=at % 11 >= 8))
    return tuple(runs)


RUNS = _runs(16)

# Homes that the network is not trained on; they calibrate its confidence.
CALIBRATION_RUNS = (
    Run("apartment?seed=31", "active"),
    Run("apartment?seed=32&texture=0.1", "frontier", rough=True),
    Run("house?seed=31", "active", LEVEL),
    Run("house?seed=32", "frontier"),
    Run("office?seed=31", "frontier", Mount(10.0, 0.5)),
    Run("office?seed=32&texture=0.5", "active"),
)


def make_default(
    robot: Path, work: Path, out: Path, settings: Settings = SETTINGS, device: str = "cpu", workers: int = 1
) -> float:
    """Writes the network to `out` and everything that it is made from to `work`; `robot` is the firmware-host. Returns
    the largest difference between ONNX Runtime and PyTorch."""
    dataset = _dataset(robot, RUNS, FRAMES, work / "store", workers)
    pairs, validation = find_pairs(dataset, None, PairRule(), settings.needs_sources)
    trainer = Trainer(dataset.frames, pairs, settings, device, dataset=dataset.summary)
    record_version(dataset, work / "training")
    _log(f"training on {len(pairs)} of {len(dataset.frames)} frames")
    with Progress(trainer, validation, STEPS, work / "training") as progress:
        checkpoint = train(trainer, STEPS, work / "training", on_step=progress)
    draw(work / "training")
    uncalibrated = work / "uncalibrated.onnx"
    difference = export_checkpoint(checkpoint, None, uncalibrated)
    further = _dataset(robot, CALIBRATION_RUNS, CALIBRATION_FRAMES, work / "calibration-store", workers)
    calibration, counts = calibrate(uncalibrated, further.frames, out, further.summary)
    _log(table(counts, calibration))
    return difference


def _dataset(robot: Path, runs: Sequence[Run], count: int, folder: Path, workers: int) -> Dataset:
    """The frames of these runs, `count` each, with coarse depth and labels; the store is `folder`, the runs are beside
    it."""
    folders = [folder.parent / run.folder for run in runs]
    for run, recorded in zip(runs, folders, strict=True):
        if not (recorded / "run/summary.json").exists():
            _explore(robot, run, count, recorded)
    tools = Tools(Recipe("robot", engine_of(robot), restart_every=RESTART_EVERY), robot, workers=workers)
    store = Store.create(folder, tools.recipe)
    prepare(folders, store, tools)
    return open_dataset([store], every=EVERY)


def _explore(robot: Path, run: Run, frames: int, folder: Path) -> None:
    """Records one run."""
    _log(f"exploring {run.home}")
    config = folder / "robot.toml"
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(run.toml().encode(), config)
    scene = ["--scene", f"builtin:{run.home}", "--policy", run.policy, "--frames", str(frames), "--seed", "1"]
    _call([str(robot), "explore", *scene, "--config", str(config), "--out", str(folder / "run")])


def _call(command: Sequence[str]) -> None:
    text = " ".join(command)
    try:
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    except OSError as problem:
        raise TrainerError(f"cannot run `{text}`: {problem}; build it with `cargo build --release`") from problem
    except subprocess.CalledProcessError as problem:
        raise TrainerError(f"`{text}` ended with {problem.returncode}; its own message is above") from problem


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def add_make_default(command: argparse.ArgumentParser) -> None:
    command.add_argument("--robot", type=Path, required=True, help="firmware-host, a release build")
    command.add_argument("--work", type=Path, required=True, help="directory for runs and training; needs 25 GB")
    add_init(command)
    add_device(command)
    add_amp(command)
    command.add_argument("--threads", type=int, default=1, help="CPU threads of the training [1]")
    command.add_argument("--workers", type=int, default=1, help="processes that prepare recordings [1]")
    command.add_argument("--out", type=Path, required=True, help="ONNX file to write")


def run_make_default(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    settings = replace(SETTINGS, init=chosen(options.init), amp=options.amp)
    device = pick_device(options.device)
    difference = make_default(options.robot, options.work, options.out, settings, device, options.workers)
    report_parity(options.out, difference)
