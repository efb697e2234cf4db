"""Algorithm 1 of Embodied Depth Prediction: the robot explores, its recording trains a network, the network is handed
over, the robot explores on with it.

Everything follows from the settings. A loop that was killed at any moment goes on to the very same result: the robot
repeats its run with the models that it had been handed, the training goes on from its checkpoint. Ground truth is only
in the test views and in the robot's own summary; nothing in the loop reads it, and the last checkpoint is the result.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from . import checkpoint as checkpoints
from .checkpoint import write_atomically
from .commands import find_pairs
from .curve import draw_curve, draw_views
from .depth_networks import build_network, takes_coarse
from .errors import TrainerError
from .export_depth import export_checkpoint
from .frames import Frames
from .labels import labels
from .locks import the_only_one, wait_for_turn
from .objectives import recipe
from .pairs import PairRule
from .replay_buffer import ReplayBuffer
from .robot import Exploration, Mission, find_firmware_host, render_views, robot_config
from .schedule import Round, Schedule
from .settings_file import same_settings
from .training import CHECKPOINT_FILE, Settings, Trainer, train
from .views import Rows, Views

RESULT_FILE = "result.json"
CHECKPOINT_EVERY = 50
# What the robot's summary says that does not depend on the computer.
KEPT_OF_SUMMARY = ("frames", "path_m", "coverage", "collisions", "stuck_frames", "bumper_trips", "digest", "accuracy")


@dataclass(frozen=True)
class LoopSettings:
    """All that shapes a loop."""

    scene: str
    policy: str
    network: str
    seed: int
    """Of the robot, of first weights and of the order of samples."""
    scale: float = 0.1
    """Of the paper's schedule."""
    size: tuple[int, int] = (96, 320)
    """Rows x columns of the robot's pictures."""
    step_scale: float = 1.0
    """Of the paper's steps of 3 cm and 2 degrees: with few frames, small steps see one room only."""
    gap: int | None = None
    """Pairs this many frames apart; `None`: by baseline."""
    batch: int = 12
    learning_rate: float = 1e-4
    labels: bool = False
    """Trained on what the whole recording knows of each picture, as the default network is, and on nothing else."""
    decay: bool = False
    """The learning rate goes down to 0 in the last training; the paper's code lowers it there as well."""
    views: int = 200
    """Test views, the same for all loops of a scene."""
    views_seed: int = 1000

    def training(self) -> Settings:
        schedule = Schedule.scaled(self.scale)
        before_last, last = (schedule.steps(index, self.batch) for index in schedule.last_two())
        settings = Settings(
            network=self.network,
            seed=self.seed,
            batch=self.batch,
            learning_rate=self.learning_rate,
            decay=(before_last, last) if self.decay else None,
            loss=recipe(self.network),
        )
        if not self.labels:
            return settings
        if settings.loss.both_ways or self.network == "manydepth_r18":
            raise TrainerError(f"`{self.network}` has a loss of its own, without labels; leave --labels out")
        return replace(settings, photometric_weight=0.0, coarse_weight=0.0, label_weight=1.0, uncertainty_weight=0.1)


def run_loop(settings: LoopSettings, out: Path, firmware_host: Path | None, views: Path | None, threads: int) -> Path:
    """Runs the loop, or what is left of it; the file with its result. `views`: test views of the scene that another
    loop may have rendered, or will use."""
    torch.set_num_threads(threads)
    # A mistake in the settings shows before anything is written.
    schedule = Schedule.scaled(settings.scale)
    needs_coarse = takes_coarse(build_network(settings.network, settings.training().depth_range_m, settings.seed))
    program = find_firmware_host(firmware_host)
    with the_only_one(out):
        same_settings(asdict(settings), out)
        if (out / RESULT_FILE).exists():
            return out / RESULT_FILE
        config = out / "robot.toml"
        text = robot_config(settings.size, settings.step_scale, schedule.warm_up, schedule.frames)
        write_atomically(text.encode(), config)
        dump = needs_coarse or settings.labels
        mission = Mission(program, settings.scene, settings.policy, settings.seed, config, schedule, dump)
        return _Loop(settings, schedule, out, mission, _views(settings, mission, views or out / "views", out)).run()


def _views(settings: LoopSettings, mission: Mission, folder: Path, out: Path) -> Views:
    folder.parent.mkdir(parents=True, exist_ok=True)
    with wait_for_turn(folder.with_name(folder.name + ".lock")):
        if not folder.exists():
            print(f"rendering {settings.views} test views of {settings.scene}", file=sys.stderr, flush=True)
            log = out / "firmware-host.log"
            render_views(
                mission.program, settings.scene, mission.config, settings.views, settings.views_seed, folder, log
            )
    return Views.read(folder)


class _Loop:
    def __init__(self, settings: LoopSettings, schedule: Schedule, out: Path, mission: Mission, views: Views) -> None:
        self.settings, self.schedule, self.out, self.views = settings, schedule, out, views
        self.exploration = Exploration(out, mission)
        self.buffer = ReplayBuffer(self.exploration.run, self.exploration.dump if mission.dump else None)

    def run(self) -> Path:
        with self.exploration:
            for round_ in self.schedule.rounds():
                if not self._is_done(round_):
                    self._do(round_)
        return self._report()

    def _point(self, index: int) -> Path:
        """Where the metrics after training `index` are kept."""
        return self.out / "rounds" / f"round_{index:04d}.json"

    def _is_done(self, round_: Round) -> bool:
        return self._point(round_.index).exists() and (round_.is_last or self.exploration.model(round_.index).exists())

    def _do(self, round_: Round) -> None:
        print(f"exploring to {round_.frames} of {self.schedule.frames} frames", file=sys.stderr, flush=True)
        if round_.is_last:
            self.exploration.wait_for_end()
            frames = self.buffer.read()
        else:
            frames = self.buffer.read(self.exploration.wait_for_round(round_.index))
        steps = self.schedule.steps(round_.index, self.settings.batch)
        checkpoint = self._train(frames, steps)
        if not round_.is_last:
            # The robot drives on while its new network is measured.
            export_checkpoint(checkpoint, None, self.exploration.model(round_.index))
        saved = checkpoints.load(checkpoint)
        metrics = self.views.evaluate({self.settings.network: saved.build()}, saved.depth_range_m)
        point = {"frames": round_.frames, "steps": steps, "metrics": metrics}
        write_atomically(json.dumps(point, indent=2).encode(), self._point(round_.index))
        delta1 = metrics["all"][self.settings.network]["delta1"]
        print(f"{round_.frames} frames, {steps} steps: delta1 {delta1:.3f}", file=sys.stderr, flush=True)

    def _train(self, frames: Frames, steps: int) -> Path:
        if self.settings.labels:
            frames = replace(frames, labels=labels(frames))
        pairs = find_pairs(frames, self.settings.gap, PairRule())
        trainer = Trainer(frames, pairs, self.settings.training())
        with tqdm(total=steps, unit="step", disable=None) as bar:

            def told(step: int, loss: float) -> None:
                bar.n = step
                bar.set_postfix(loss=f"{loss:.4f}", refresh=False)
                bar.update(0)

            return train(trainer, steps, self.out / "training", CHECKPOINT_EVERY, told)

    def _report(self) -> Path:
        saved = checkpoints.load(self.out / "training" / CHECKPOINT_FILE)
        # What trivial answers score, and the curve's beginning.
        untrained = build_network(saved.network, saved.depth_range_m, self.settings.seed).eval()
        first = {
            "frames": 0,
            "steps": 0,
            "metrics": self.views.evaluate({self.settings.network: untrained}, saved.depth_range_m),
        }
        points = [json.loads(self._point(round_.index).read_text()) for round_ in self.schedule.rounds()]
        summary = self.exploration.summary()
        result: dict[str, Any] = {
            "settings": asdict(self.settings),
            "schedule": asdict(self.schedule),
            "exploration": {key: summary[key] for key in KEPT_OF_SUMMARY if key in summary},
            "curve": [first, *points],
        }
        network = saved.build()
        title = f"{self.settings.scene}, {self.settings.policy}, {self.settings.network}, seed {self.settings.seed}"
        draw_curve({title: curve_of(result)}, self.out / "curve.png")
        draw_views(self.views, network, saved.depth_range_m, title, self.out / "views.png")
        write_atomically(json.dumps(result, indent=2).encode(), self.out / RESULT_FILE)
        return self.out / RESULT_FILE


def curve_of(result: dict[str, Any], part: str = "all", metric: str = "delta1") -> dict[str, list[tuple[int, float]]]:
    """(frames, metric) of the network and of what it is compared with, by their names."""
    network = result["settings"]["network"]
    points: list[dict[str, Any]] = result["curve"]

    def line(name: str) -> list[tuple[int, float]]:
        rows: list[tuple[int, Rows]] = [(point["frames"], point["metrics"]) for point in points]
        return [(frames, metrics[part][name][metric]) for frames, metrics in rows if name in metrics[part]]

    names = {network: network, "constant": "constant (median of the truth)", "coarse": "coarse, where it has depth"}
    return {said: line(name) for name, said in names.items() if line(name)}
