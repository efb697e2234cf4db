"""`embodied-depth adapt`: measures how much better depth gets in a simulated home by training on a drive through it."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from embodied_depth_trainer.commands.arguments import POLICIES, add_amp, add_device, add_firmware_host, add_init
from embodied_depth_trainer.commands.watch import ENDLESS, WatchSettings, watch
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.studies.adaptation import (
    RESULT_FILE,
    AdaptationSettings,
    as_table,
    check_rounds,
    draw,
    measured,
    pull,
)
from embodied_depth_trainer.studies.locks import exclusive
from embodied_depth_trainer.studies.robot import explore, find_firmware_host, render_views
from embodied_depth_trainer.studies.settings_file import keep_settings, plain
from embodied_depth_trainer.studies.views import Views
from embodied_depth_trainer.training.initial import SHIPPED_NAME, chosen, is_exported


def adapt(settings: AdaptationSettings, out: Path, robot: Path, watching: WatchSettings) -> list[dict[str, Any]]:
    """Runs the study or what is left of it; returns its points. `watching` says how the rounds are trained."""
    with exclusive(out):
        keep_settings(plain(asdict(settings)), out)
        log = out / "firmware-host.log"
        config = out / "robot.toml"
        write_atomically(b"", config)
        if not (out / "run").exists():
            _say(f"exploring {settings.scene} for {settings.after[-1]} frames")
            explore(
                robot,
                settings.scene,
                settings.policy,
                settings.seed,
                settings.after[-1],
                config,
                out / "run",
                log,
                dump=False,
            )
        check_rounds(out / "run", settings.after)
        if not (out / "views").exists():
            _say(f"rendering {settings.views} test views")
            render_views(robot, settings.scene, config, settings.views, settings.views_seed, out / "views", log)
        views = Views.read(out / "views")
        curve: list[dict[str, Any]] = []
        if settings.init is not None:
            curve.append({"frames": 0, "steps": 0, "metrics": measured(Path(settings.init), views)})
        for round_, frames in enumerate(settings.after):
            curve.append(_point(settings, out, watching, round_, frames, views))
        result = {"settings": plain(asdict(settings)), "curve": curve}
        write_atomically(json.dumps(result, indent=2).encode(), out / RESULT_FILE)
    return curve


def _point(
    settings: AdaptationSettings, out: Path, watching: WatchSettings, round_: int, frames: int, views: Views
) -> dict[str, Any]:
    """Trains one round on the first `frames` frames and measures its network."""
    file = out / "rounds" / f"round_{round_:04d}.json"
    if not file.exists():
        pulled = pull(out / "run", frames, out / "pulled")
        watch(replace(watching, rounds=round_ + 1))
        network = out / "watch/models" / f"model_{round_:04d}.onnx"
        steps = (round_ + 1) * settings.steps
        made = {"frames": pulled, "steps": steps, "metrics": measured(network, views)}
        write_atomically(json.dumps(made, indent=2).encode(), file)
    point: dict[str, Any] = json.loads(file.read_text())
    right = {part: rows["network"]["right"] for part, rows in point["metrics"].items()}
    _say(f"{point['frames']} frames: right " + ", ".join(f"{part} {value:.3f}" for part, value in right.items()))
    return point


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def add_adapt(command: argparse.ArgumentParser) -> None:
    defaults = AdaptationSettings("")
    command.add_argument(
        "--scene", required=True, help="builtin:apartment?seed=1 (also house, office), or a .glb, .gltf or .obj file"
    )
    command.add_argument("--policy", choices=POLICIES, default=defaults.policy)
    command.add_argument("--seed", type=int, default=defaults.seed, help="seed of the robot [1]")
    command.add_argument(
        "--after",
        type=int,
        nargs="+",
        default=defaults.after,
        metavar="FRAMES",
        help="frames after which the network is trained; the last is the length of the drive "
        f"[{' '.join(map(str, defaults.after))}]",
    )
    command.add_argument(
        "--steps", type=int, default=defaults.steps, help=f"training steps of a round [{defaults.steps}]"
    )
    command.add_argument("--views", type=int, default=defaults.views, help=f"number of test views [{defaults.views}]")
    command.add_argument(
        "--views-seed", type=int, default=defaults.views_seed, help=f"seed of the test views [{defaults.views_seed}]"
    )
    command.add_argument("--out", type=Path, required=True, help="directory; an interrupted study in it continues")
    add_firmware_host(command)
    add_init(command, SHIPPED_NAME)
    add_device(command)
    add_amp(command)
    command.add_argument("--threads", type=int, default=1, help="CPU threads [1]")


def run_adapt(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    init = options.init or SHIPPED_NAME
    first = chosen(init)
    if first is not None and not is_exported(first):
        raise TrainerError(
            f"--init {first} is measured as a robot uses it; give an ONNX file of `embodied-depth export`"
        )
    settings = AdaptationSettings(
        scene=options.scene,
        policy=options.policy,
        seed=options.seed,
        after=tuple(options.after),
        steps=options.steps,
        views=options.views,
        views_seed=options.views_seed,
        init=first,
    )
    robot = find_firmware_host(options.firmware_host)
    watching = WatchSettings(
        options.out / "pulled",
        options.out / "watch",
        robot,
        # Every call of `watch` has new segments, however few.
        frames=1,
        steps=options.steps,
        training=replace(ENDLESS, amp=options.amp),
        init=init,
        device=pick_device(options.device),
    )
    curve = adapt(settings, options.out, robot, watching)
    draw(curve, Path(settings.scene).name, options.out / "curve.png")
    print(as_table(curve))
    _say(f"{options.out / RESULT_FILE}; see curve.png beside it")
