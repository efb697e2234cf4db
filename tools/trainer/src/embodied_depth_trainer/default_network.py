"""The robot's default network, made anew: runs through simulated homes, their coarse depth, labels, training, export.

What is there already is kept, so that a recipe that was interrupted goes on. Homes with seeds below 10 are held apart:
the demo's, those of the README and those of the model card. No run records ground truth.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .calibration import calibrate, table
from .checkpoint import write_atomically
from .commands import read_frames
from .errors import TrainerError
from .export_depth import export_checkpoint
from .frames import Frames
from .labels import write_labels
from .pairs import PairRule, pairs_by_baseline
from .training import Settings, Trainer, train

FRAMES = 700
# Two numbers need less than a network.
CALIBRATION_FRAMES = 300
# Neighbours 3 cm apart say the same.
EVERY = 2
STEPS, DECAY_STEPS = 3600, 2000
SETTINGS = Settings(
    network="student",
    batch=8,
    learning_rate=2e-3,
    decay=(STEPS - DECAY_STEPS, STEPS),
    crop_width=320,
    # Labels say what coarse depth does, and what two neighbours' colours can, and more, at a quarter of the time.
    photometric_weight=0.0,
    coarse_weight=0.0,
    label_weight=1.0,
    uncertainty_weight=0.1,
)
# A base whose wheels slip as a good one's do, and a camera with automatic exposure under lamps and sun
# (keys of robot.default.toml).
ROUGH = """\
[simulator]
odometry_distance_noise = 0.01
odometry_turn_noise = 0.02
[simulator.nuisances]
exposure_drift_stops = 0.7
flicker = 0.1
sun_patches = 1.0
sensor_noise = 3.0
"""


@dataclass(frozen=True)
class Run:
    """One walk through one home."""

    home: str
    policy: str
    rough: bool = False

    @property
    def folder(self) -> str:
        return self.home.replace("?", "_").replace("&", "_").replace("=", "")


RUNS = (
    Run("apartment?seed=11", "active"),
    Run("apartment?seed=12", "frontier", rough=True),
    Run("apartment?seed=13", "active"),
    Run("apartment?seed=14&texture=0.3", "frontier"),
    Run("apartment?seed=15", "forward"),
    Run("apartment?seed=16", "heuristic"),
    Run("apartment?seed=17", "active", rough=True),
    Run("apartment?seed=18&texture=0.8", "frontier"),
    Run("house?seed=11", "active"),
    Run("house?seed=12", "frontier"),
    Run("house?seed=13&texture=0.3", "active", rough=True),
    Run("house?seed=14", "forward"),
    Run("office?seed=11", "active"),
    Run("office?seed=12", "frontier"),
    Run("office?seed=13&texture=0.3", "active"),
    Run("office?seed=14", "heuristic", rough=True),
)

# Homes that the weights do not see: they say how sure the network may be.
CALIBRATION_RUNS = (
    Run("apartment?seed=31", "active"),
    Run("apartment?seed=32&texture=0.3", "frontier", rough=True),
    Run("house?seed=31", "active"),
    Run("office?seed=31", "frontier"),
)


def make_default(robot: Path, work: Path, out: Path) -> float:
    """Writes the network to `out` and everything on the way to it into `work`; `robot` is the firmware-host. Returns
    the largest difference between ONNX Runtime and PyTorch."""
    frames = _frames(robot, RUNS, FRAMES, work)
    trainer = Trainer(frames, pairs_by_baseline(frames, PairRule()), SETTINGS)
    _tell(f"training on {len(frames)} pictures")
    checkpoint = train(trainer, STEPS, work / "training", told=_progress)
    uncalibrated = work / "uncalibrated.onnx"
    difference = export_checkpoint(checkpoint, None, uncalibrated)
    further = _frames(robot, CALIBRATION_RUNS, CALIBRATION_FRAMES, work)
    calibration, counts = calibrate(uncalibrated, further, out)
    _tell(table(counts, calibration))
    return difference


def _frames(robot: Path, runs: Sequence[Run], count: int, work: Path) -> Frames:
    """What the robot saw in these runs of `count` frames, with coarse depth and labels."""
    write_atomically(ROUGH.encode(), work / "rough.toml")
    folders = [work / run.folder for run in runs]
    for run, folder in zip(runs, folders, strict=True):
        _prepare(robot, run, count, folder, work / "rough.toml")
    recordings, coarse = [folder / "run" for folder in folders], [folder / "coarse" for folder in folders]
    return read_frames(recordings, coarse, [], None, [folder / "labels.npz" for folder in folders], EVERY)


def _prepare(robot: Path, run: Run, frames: int, folder: Path, rough: Path) -> None:
    """One run, its coarse depth and its labels."""
    if not (folder / "run/summary.json").exists():
        _tell(f"exploring {run.home}")
        scene = ["--scene", f"builtin:{run.home}", "--policy", run.policy, "--frames", str(frames), "--seed", "1"]
        config = ["--config", str(rough)] if run.rough else []
        _call([str(robot), "explore", *scene, *config, "--out", str(folder / "run")])
    if not (folder / "coarse/dump.json").exists():
        where = ["--out", str(folder / "look"), "--dump", str(folder / "coarse")]
        _call([str(robot), "perceive", "--recording", str(folder / "run"), *where])
    if not (folder / "labels.npz").exists():
        _tell(f"labels of {run.home}")
        write_labels(read_frames([folder / "run"], [folder / "coarse"], [], None), folder / "labels.npz")


def _call(command: Sequence[str]) -> None:
    text = " ".join(command)
    try:
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    except OSError as problem:
        raise TrainerError(f"cannot run `{text}`: {problem}; build it with `cargo build --release`") from problem
    except subprocess.CalledProcessError as problem:
        raise TrainerError(f"`{text}` ended with {problem.returncode}; its own message is above") from problem


def _progress(step: int, loss: float) -> None:
    if step % 100 == 0:
        _tell(f"step {step} of {STEPS}, loss {loss:.4f}")


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
