"""A study of many homes: a robot explores each, one network per policy and architecture learns from all recordings,
and is evaluated in every home.

The robots drive on coarse depth, so a policy's recordings are the same for all networks, which makes it cheap to
compare many networks; in `loop`, every network drives its own robot. Existing results are kept: an interrupted study
continues, policy by policy.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from embodied_depth_trainer.data.dataset import find_pairs, read_frames
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.pairs import PairRule
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.losses.recipes import recipe
from embodied_depth_trainer.networks.inputs import give
from embodied_depth_trainer.studies.locks import exclusive
from embodied_depth_trainer.studies.loop import RESULT_FILE
from embodied_depth_trainer.studies.robot import explore, find_firmware_host, render_views, robot_config
from embodied_depth_trainer.studies.settings_file import keep_settings, plain
from embodied_depth_trainer.studies.views import Views
from embodied_depth_trainer.training import checkpoint as checkpoints
from embodied_depth_trainer.training.initial import given_depth, initial_network
from embodied_depth_trainer.training.progress import Progress
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

# Every policy begins with the same warm-up, a fifth of the frames, as in the paper.
WARM_UP = 5
CHECKPOINT_EVERY = 100


@dataclass(frozen=True)
class FleetSettings:
    """The settings that all robots and networks share. The names are part of the formats of `settings.json` and
    `result.json`."""

    frames: int
    """Number of frames for which each robot explores."""
    steps: int
    """Steps of each training."""
    seed: int = 1
    size: tuple[int, int] = (96, 320)
    """Rows x columns of the robots' images."""
    step_scale: float = 1.0
    """Multiplies the paper's steps of 3 cm and 2 degrees."""
    gap: int | None = None
    """Distance of the pairs in frames; `None`: pairs by baseline."""
    batch: int = 12
    learning_rate: float = 1e-4
    encoder: str | None = None
    """Initial weights of every ResNet18 image encoder; see `imagenet_weights.py`."""
    views: int = 200
    views_seed: int = 1000
    init: str | None = None
    """File of the weights to go on from, of the one network that is trained; `None`: random."""
    amp: bool = False

    def training(self, network: str) -> Settings:
        """The settings of the network's authors, without labels; the learning rate falls in the second half."""
        return Settings(
            network=network,
            seed=self.seed,
            batch=self.batch,
            learning_rate=self.learning_rate,
            decay=(self.steps // 2, self.steps),
            # Watson et al. 2021 stop teaching the teacher after three quarters.
            teacher_steps=3 * self.steps // 4,
            encoder=None if network == "student" else self.encoder,
            init=self.init,
            given_depth=given_depth(self.init),
            amp=self.amp,
            loss=recipe(network),
        )

    def plain(self) -> dict[str, Any]:
        """The content of `result.json`, with the names of files instead of their paths."""
        encoder = None if self.encoder is None else Path(self.encoder).name
        return plain({**asdict(self), "encoder": encoder})


class Fleet:
    """The robots, their recordings, and the trainings and results below `out`."""

    def __init__(
        self,
        settings: FleetSettings,
        scenes: Sequence[str],
        out: Path,
        firmware_host: Path | None,
        device: str = "cpu",
    ) -> None:
        self.device = device
        self.settings = settings
        self.scenes = scenes
        self.out = out
        self.program = find_firmware_host(firmware_host)
        self.config = out / "robot.toml"
        self.log = out / "firmware-host.log"

    def study(self, policies: Sequence[str], networks: Sequence[str], threads: int) -> None:
        """Runs every policy with every network, in this order."""
        torch.set_num_threads(threads)
        with exclusive(self.out):
            settings = self.settings
            # Another choice of pairs is another training on the same recordings.
            keep_settings({**settings.plain(), "gap": "any"}, self.out)
            config = robot_config(settings.size, settings.step_scale, settings.frames // WARM_UP, settings.frames)
            write_atomically(config.encode(), self.config)
            for policy in policies:
                missing = [network for network in networks if not self._is_done(policy, network)]
                if missing:
                    frames = self._recorded(policy)
                    for network in missing:
                        self._evaluate(policy, network, self._trained(policy, network, frames))

    def _name(self, policy: str, network: str) -> str:
        pairs = "" if self.settings.gap is None else f"_gap{self.settings.gap}"
        return f"{policy}_{network}{pairs}"

    def _result(self, scene: str, policy: str, network: str) -> Path:
        return self.out / "results" / home(scene) / self._name(policy, network) / RESULT_FILE

    def _is_done(self, policy: str, network: str) -> bool:
        return all(self._result(scene, policy, network).exists() for scene in self.scenes)

    def _run(self, scene: str, policy: str) -> Path:
        return self.out / "recordings" / f"{home(scene)}_{policy}"

    def _recorded(self, policy: str) -> Frames:
        """The frames of the robots in all homes."""
        runs = [self._run(scene, policy) for scene in self.scenes]
        for scene, run in tqdm(list(zip(self.scenes, runs, strict=True)), desc=f"{policy}: exploring", disable=None):
            if not run.exists():
                settings = self.settings
                explore(self.program, scene, policy, settings.seed, settings.frames, self.config, run, self.log)
        return read_frames(runs, [run / "coarse" for run in runs], [], None)

    def _trained(self, policy: str, network: str, frames: Frames) -> Path:
        settings = self.settings
        pairs, validation = find_pairs(frames, settings.gap, PairRule())
        print(
            f"{self._name(policy, network)}: {len(frames)} frames, {len(pairs)} of them have source frames",
            file=sys.stderr,
        )
        trainer = Trainer(frames, pairs, settings.training(network), self.device)
        folder = self.out / "trainings" / self._name(policy, network)
        with Progress(trainer, validation, settings.steps, folder) as progress:
            return train(trainer, settings.steps, folder, CHECKPOINT_EVERY, progress)

    def _evaluate(self, policy: str, network: str, checkpoint: Path) -> None:
        """Evaluates the trained and the untrained network in every home."""
        saved = checkpoints.load(checkpoint)
        untrained = give(
            initial_network(network, saved.depth_range_m, self.settings.seed, self.settings.init), saved.given_depth
        )
        trained = saved.build()
        shared = self.settings.plain()
        schedule = {key: shared.pop(key) for key in ("frames", "steps")}
        for scene in self.scenes:
            views = self._views(scene)
            rows = [views.evaluate({network: candidate}, saved.depth_range_m) for candidate in (untrained, trained)]
            total_frames = self.settings.frames * len(self.scenes)
            curve = [
                {"frames": 0, "steps": 0, "metrics": rows[0]},
                {"frames": total_frames, "steps": saved.step, "metrics": rows[1]},
            ]
            summary = json.loads((self._run(scene, policy) / "summary.json").read_text())
            result = {
                # A scene's file by its name instead of its path.
                "settings": {"scene": Path(scene).name, "policy": policy, "network": network, **shared},
                "schedule": {**schedule, "homes": len(self.scenes)},
                "exploration": {"coverage": summary["coverage"]},
                "curve": curve,
            }
            write_atomically(json.dumps(result, indent=2).encode(), self._result(scene, policy, network))
            delta1 = rows[-1]["all"][network]["delta1"]
            print(f"{self._name(policy, network)}, {scene}: delta1 {delta1:.3f}", file=sys.stderr, flush=True)

    def _views(self, scene: str) -> Views:
        folder = self.out / "views" / home(scene)
        if not folder.exists():
            settings = self.settings
            render_views(self.program, scene, self.config, settings.views, settings.views_seed, folder, self.log)
        return Views.read(folder)


def home(scene: str) -> str:
    """A scene's name as a directory name."""
    return re.sub(r"\W+", "-", Path(scene).name.removeprefix("builtin:"))
