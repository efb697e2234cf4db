"""Algorithm 1 of Embodied Depth Prediction: the robot explores, its recording trains a network, the robot receives the
network and continues to explore with it.

Everything follows from the settings. A loop that is killed at any moment continues to exactly the same result: the
robot repeats its run with the models that it had received, and the training continues from its checkpoint. Ground
truth exists only in the test views and in the robot's own summary. The loop does not read it, and the last checkpoint
is the result.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from embodied_depth_trainer.data.dataset import find_pairs
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import labels
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.data.replay_buffer import ReplayBuffer
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.depth import export_checkpoint
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.losses.recipes import recipe
from embodied_depth_trainer.networks.inputs import give
from embodied_depth_trainer.networks.registry import build_network, takes_coarse
from embodied_depth_trainer.studies.locks import exclusive, wait_for_lock
from embodied_depth_trainer.studies.plots import draw_curve, draw_views
from embodied_depth_trainer.studies.robot import Exploration, Mission, find_firmware_host, render_views, robot_config
from embodied_depth_trainer.studies.schedule import Round, Schedule
from embodied_depth_trainer.studies.settings_file import keep_settings, plain
from embodied_depth_trainer.studies.views import Rows, Views
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.initial import given_depth, initial_network
from embodied_depth_trainer.training.progress import Progress
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import CHECKPOINT_FILE, Trainer, train

RESULT_FILE = "result.json"
CHECKPOINT_EVERY = 50
# The entries of the robot's summary that do not depend on the computer.
KEPT_OF_SUMMARY = ("frames", "path_m", "coverage", "collisions", "stuck_frames", "bumper_trips", "digest", "accuracy")


@dataclass(frozen=True)
class LoopSettings:
    """The settings of a loop. The names are part of the formats of `settings.json` and `result.json`."""

    scene: str
    policy: str
    network: str
    seed: int
    """Seed of the robot, of the initial weights and of the order of samples."""
    scale: float = 0.1
    """Multiplies the paper's schedule."""
    size: tuple[int, int] = (96, 320)
    """Rows x columns of the robot's images."""
    step_scale: float = 1.0
    """Multiplies the paper's steps of 3 cm and 2 degrees; with few frames, small steps would cover one room only."""
    gap: int | None = None
    """Distance of the pairs in frames; `None`: pairs by baseline."""
    batch: int = 12
    learning_rate: float = 1e-4
    labels: bool = False
    """Trains only on labels from the whole recording, as the default network does."""
    decay: bool = False
    """Reduces the learning rate to 0 during the last training; the paper's code reduces it there as well."""
    views: int = 200
    """Number of test views, which all loops of a scene share."""
    views_seed: int = 1000
    init: str | None = None
    """File of the weights to go on from; `None`: random."""
    amp: bool = False

    def training(self) -> Settings:
        schedule = Schedule.scaled(self.scale)
        before_last, last = (schedule.steps(index, self.batch) for index in schedule.last_two())
        settings = Settings(
            network=self.network,
            seed=self.seed,
            batch=self.batch,
            learning_rate=self.learning_rate,
            decay=(before_last, last) if self.decay else None,
            init=self.init,
            given_depth=given_depth(self.init),
            amp=self.amp,
            loss=recipe(self.network),
        )
        if not self.labels:
            return settings
        if settings.loss.both_ways or self.network == "manydepth_r18":
            raise TrainerError(f"`{self.network}` has its own loss, which does not use labels; omit --labels")
        return replace(settings, photometric_weight=0.0, coarse_weight=0.0, label_weight=1.0, uncertainty_weight=0.1)


def run_loop(
    settings: LoopSettings,
    out: Path,
    firmware_host: Path | None,
    views: Path | None,
    threads: int,
    device: str = "cpu",
) -> Path:
    """Runs the loop or what is left of it, and returns the file with its result. `views` is a directory of test views
    that loops in the same scene share; the first one renders them."""
    torch.set_num_threads(threads)
    # Reports mistakes in the settings before anything is written.
    schedule = Schedule.scaled(settings.scale)
    needs_coarse = takes_coarse(build_network(settings.network, settings.training().depth_range_m, settings.seed))
    program = find_firmware_host(firmware_host)
    with exclusive(out):
        keep_settings(plain(asdict(settings)), out)
        if (out / RESULT_FILE).exists():
            return out / RESULT_FILE
        config = out / "robot.toml"
        text = robot_config(settings.size, settings.step_scale, schedule.warm_up, schedule.frames)
        write_atomically(text.encode(), config)
        dump = needs_coarse or settings.labels
        mission = Mission(program, settings.scene, settings.policy, settings.seed, config, schedule, dump)
        found = _views(settings, mission, views or out / "views", out)
        return _Loop(settings, schedule, out, mission, found, device).run()


def _views(settings: LoopSettings, mission: Mission, folder: Path, out: Path) -> Views:
    folder.parent.mkdir(parents=True, exist_ok=True)
    with wait_for_lock(folder.with_name(folder.name + ".lock")):
        if not folder.exists():
            print(f"rendering {settings.views} test views of {settings.scene}", file=sys.stderr, flush=True)
            log = out / "firmware-host.log"
            render_views(
                mission.program, settings.scene, mission.config, settings.views, settings.views_seed, folder, log
            )
    return Views.read(folder)


class _Loop:
    def __init__(
        self, settings: LoopSettings, schedule: Schedule, out: Path, mission: Mission, views: Views, device: str
    ) -> None:
        self.settings = settings
        self.device = device
        self.schedule = schedule
        self.out = out
        self.views = views
        self.exploration = Exploration(out, mission)
        self.buffer = ReplayBuffer(self.exploration.run, self.exploration.dump if mission.dump else None)

    def run(self) -> Path:
        with self.exploration:
            for round_ in self.schedule.rounds():
                if not self._is_done(round_):
                    self._do(round_)
        return self._report()

    def _point(self, index: int) -> Path:
        """The file of the metrics after training `index`."""
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
            # The robot continues to drive while its new network is evaluated.
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
        settings = self.settings.training()
        pairs, validation = find_pairs(frames, self.settings.gap, PairRule(), settings.needs_sources)
        trainer = Trainer(frames, pairs, settings, self.device)
        folder = self.out / "training"
        with Progress(trainer, validation, steps, folder, CHECKPOINT_EVERY) as progress:
            return train(trainer, steps, folder, CHECKPOINT_EVERY, progress)

    def _report(self) -> Path:
        saved = checkpoints.load(self.out / "training" / CHECKPOINT_FILE)
        # The baselines, and the beginning of the curve.
        settings = self.settings
        untrained = give(
            initial_network(saved.network, saved.depth_range_m, settings.seed, settings.init), saved.given_depth
        )
        first = {
            "frames": 0,
            "steps": 0,
            "metrics": self.views.evaluate({self.settings.network: untrained}, saved.depth_range_m),
        }
        points = [json.loads(self._point(round_.index).read_text()) for round_ in self.schedule.rounds()]
        summary = self.exploration.summary()
        result: dict[str, Any] = {
            "settings": plain(asdict(settings)),
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
    """(frames, metric) of the network and of the baselines, by their names."""
    network = result["settings"]["network"]
    points: list[dict[str, Any]] = result["curve"]

    def line(name: str) -> list[tuple[int, float]]:
        rows: list[tuple[int, Rows]] = [(point["frames"], point["metrics"]) for point in points]
        return [(frames, metrics[part][name][metric]) for frames, metrics in rows if name in metrics[part]]

    titles = {network: network, "constant": "constant (median of the truth)", "coarse": "coarse, where it has depth"}
    return {title: line(name) for name, title in titles.items() if line(name)}
