"""Many homes at once: a robot explores each of them, one network learns from all that they recorded, and is judged in
every home. For every policy and every network.

The robots drive on coarse depth. So a policy's recordings are the same for all networks, which makes many networks
cheap to compare; in `loop`, every network drives its own robot. What is there is not made again: a study that was cut
off goes on, policy by policy.
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

from . import checkpoint as checkpoints
from .checkpoint import write_atomically
from .commands import find_pairs, read_frames
from .depth_networks import build_network
from .frames import Frames
from .locks import the_only_one
from .loop import RESULT_FILE
from .objectives import recipe
from .pairs import PairRule
from .robot import explore, find_firmware_host, render_views, robot_config
from .settings_file import same_settings
from .training import Settings, Trainer, train
from .views import Views

# Every policy begins with a fifth of the frames in the same way, as in the paper.
WARM_UP = 5
CHECKPOINT_EVERY = 100


@dataclass(frozen=True)
class FleetSettings:
    """What all robots and networks share."""

    frames: int
    """Each robot explores so long."""
    steps: int
    """Of each training."""
    seed: int = 1
    size: tuple[int, int] = (96, 320)
    """Rows x columns of the robots' pictures."""
    step_scale: float = 1.0
    """Of the paper's steps of 3 cm and 2 degrees."""
    gap: int | None = None
    """Pairs this many frames apart; `None`: by baseline."""
    batch: int = 12
    learning_rate: float = 1e-4
    encoder: str | None = None
    """What every ResNet18 that sees pictures begins with; see `resnet_weights.py`."""
    views: int = 200
    views_seed: int = 1000

    def training(self, network: str) -> Settings:
        """By the network's own recipe, without labels; the learning rate goes down in the second half."""
        return Settings(
            network=network,
            seed=self.seed,
            batch=self.batch,
            learning_rate=self.learning_rate,
            decay=(self.steps // 2, self.steps),
            # Watson et al. 2021 stop teaching the teacher after three quarters.
            teacher_steps=3 * self.steps // 4,
            encoder=None if network == "student" else self.encoder,
            loss=recipe(network),
        )

    def plain(self) -> dict[str, Any]:
        """For `result.json`: an encoder by its name, wherever its file lies."""
        return {**asdict(self), "encoder": None if self.encoder is None else Path(self.encoder).name}


class Fleet:
    """Robots in homes, and what is made of their recordings below `out`."""

    def __init__(self, settings: FleetSettings, scenes: Sequence[str], out: Path, firmware_host: Path | None) -> None:
        self.settings, self.scenes, self.out = settings, scenes, out
        self.program = find_firmware_host(firmware_host)
        self.config, self.log = out / "robot.toml", out / "firmware-host.log"

    def study(self, policies: Sequence[str], networks: Sequence[str], threads: int) -> None:
        """Every policy with every network, in this order."""
        torch.set_num_threads(threads)
        with the_only_one(self.out):
            settings = self.settings
            # Other pairs are another training on the same recordings.
            same_settings({**settings.plain(), "gap": "any"}, self.out)
            config = robot_config(settings.size, settings.step_scale, settings.frames // WARM_UP, settings.frames)
            write_atomically(config.encode(), self.config)
            for policy in policies:
                missing = [network for network in networks if not self._is_done(policy, network)]
                if missing:
                    frames = self._recorded(policy)
                    for network in missing:
                        self._judge(policy, network, self._trained(policy, network, frames))

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
        """What the robots of all homes saw."""
        runs = [self._run(scene, policy) for scene in self.scenes]
        for scene, run in tqdm(list(zip(self.scenes, runs, strict=True)), desc=f"{policy}: exploring", disable=None):
            if not run.exists():
                settings = self.settings
                explore(self.program, scene, policy, settings.seed, settings.frames, self.config, run, self.log)
        return read_frames(runs, [run / "coarse" for run in runs], [], None)

    def _trained(self, policy: str, network: str, frames: Frames) -> Path:
        settings = self.settings
        pairs = find_pairs(frames, settings.gap, PairRule())
        print(
            f"{self._name(policy, network)}: {len(frames)} pictures, {len(pairs)} of them with sources", file=sys.stderr
        )
        trainer = Trainer(frames, pairs, settings.training(network))
        with tqdm(total=settings.steps, unit="step", disable=None) as bar:

            def told(step: int, loss: float) -> None:
                bar.n = step
                bar.set_postfix(loss=f"{loss:.4f}", refresh=False)
                bar.update(0)

            folder = self.out / "trainings" / self._name(policy, network)
            return train(trainer, settings.steps, folder, CHECKPOINT_EVERY, told)

    def _judge(self, policy: str, network: str, checkpoint: Path) -> None:
        """In every home, beside the network as it began."""
        saved = checkpoints.load(checkpoint)
        untrained, trained = build_network(network, saved.depth_range_m, self.settings.seed).eval(), saved.build()
        shared = self.settings.plain()
        schedule = {key: shared.pop(key) for key in ("frames", "steps")}
        for scene in self.scenes:
            views = self._views(scene)
            rows = [views.evaluate({network: judged}, saved.depth_range_m) for judged in (untrained, trained)]
            seen = self.settings.frames * len(self.scenes)
            curve = [
                {"frames": 0, "steps": 0, "metrics": rows[0]},
                {"frames": seen, "steps": saved.step, "metrics": rows[1]},
            ]
            summary = json.loads((self._run(scene, policy) / "summary.json").read_text())
            result = {
                # A file by its name, wherever it lies.
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
    """A scene's name as that of a folder."""
    return re.sub(r"\W+", "-", Path(scene).name.removeprefix("builtin:"))
