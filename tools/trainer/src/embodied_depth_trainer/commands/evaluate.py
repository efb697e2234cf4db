"""`embodied-depth evaluate`: measures a trained network beside simple baselines."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import nn

from embodied_depth_trainer.commands.arguments import add_device, add_dumps, add_threads, image_size
from embodied_depth_trainer.data.dataset import read_frames
from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.networks.inputs import give, given_depth_of
from embodied_depth_trainer.networks.registry import DEPTH_NETWORKS, build_network
from embodied_depth_trainer.networks.runtime import OnnxNetwork
from embodied_depth_trainer.processes import pick_device
from embodied_depth_trainer.studies.evaluation import evaluate, table
from embodied_depth_trainer.studies.views import Views
from embodied_depth_trainer.training import checkpoint as checkpoints


def add_evaluate(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--recording", type=Path, action="append", default=[], help="--out directory of a run; may be repeated"
    )
    command.add_argument(
        "--coarse",
        type=Path,
        action="append",
        default=[],
        help="dump of the same run by `firmware-host perceive --dump`; one for each --recording",
    )
    add_dumps(command)
    command.add_argument("--every", type=int, default=1, help="use every Nth frame of a recording [1]")
    command.add_argument("--size", type=image_size, help="reduce the images to rows x columns")
    add_device(command)
    add_threads(command)
    command.add_argument("--checkpoint", type=Path, help="checkpoint.pt of a training [only the baselines]")
    command.add_argument(
        "--model", type=Path, help="ONNX file of `export`, computed by ONNX Runtime; instead of --checkpoint"
    )
    command.add_argument(
        "--views",
        type=Path,
        help="evaluate on test views instead, the output of `firmware-host views`; also reports the views after a "
        "rotation on the spot separately",
    )
    command.add_argument("--json", type=Path, help="also write the numbers to this file")


@dataclass(frozen=True)
class _Chosen:
    """The networks to measure, and what they need."""

    networks: dict[str, nn.Module]
    size: tuple[int, int] | None = None
    """Rows, columns; `None`: those of the frames."""
    depth_range_m: tuple[float, float] = (0.1, 20.0)
    past: PastFrames | None = None


def _chosen(options: argparse.Namespace) -> _Chosen:
    if options.checkpoint is not None and options.model is not None:
        raise TrainerError(f"give either --checkpoint {options.checkpoint} or --model {options.model}")
    if options.model is not None:
        model = OnnxNetwork(options.model)
        name = model.metadata.get("architecture", "")
        networks: dict[str, nn.Module] = {}
        if name in DEPTH_NETWORKS:
            networks["untrained"] = give(build_network(name, model.depth_range_m, 0), given_depth_of(model))
        return _Chosen({**networks, model.title: model}, model.size, model.depth_range_m)
    if options.checkpoint is None:
        return _Chosen({})
    saved = checkpoints.load(options.checkpoint)
    untrained = build_network(saved.network, saved.depth_range_m, int(saved.settings["seed"]))
    networks = {"untrained": give(untrained, saved.given_depth)}
    networks[f"{saved.network}, {saved.step} steps"] = saved.build()
    return _Chosen(networks, (saved.camera.height, saved.camera.width), saved.depth_range_m, saved.past_frames)


def run_evaluate(options: argparse.Namespace) -> None:
    torch.set_num_threads(options.threads)
    device = pick_device(options.device)
    chosen = _chosen(options)
    networks = {name: network.to(device) for name, network in chosen.networks.items()}
    size = options.size or chosen.size
    depth_range_m = chosen.depth_range_m
    past = chosen.past
    if options.views is not None:
        if past is not None:
            raise TrainerError("test views have no past frames to compute coarse depth from; give a --recording")
        parts = Views.read(options.views).metrics(networks, depth_range_m)
    else:
        frames = read_frames(options.recording, options.coarse, options.dataset, size, every=options.every, past=past)
        parts = {"all": evaluate(frames, networks, depth_range_m)}
    print("\n\n".join((f"{part}:\n" if len(parts) > 1 else "") + table(rows) for part, rows in parts.items()))
    if options.json is not None:
        plain = {part: {name: asdict(row) for name, row in rows.items()} for part, rows in parts.items()}
        write_atomically(json.dumps(plain if options.views else plain["all"], indent=2).encode(), options.json)
