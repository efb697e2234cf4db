"""What training has reached, in one file that is there whole or not at all."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from .depth_networks import build_network
from .errors import TrainerError
from .frames import Intrinsics
from .past_frames import PastFrames

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """Everything that the next step depends on, besides the frames."""

    step: int
    """Steps that are done."""
    network: str
    settings: dict[str, Any]
    """What shapes the training; resuming with others is refused."""
    weights: dict[str, Tensor]
    optimizer: dict[str, Any]

    @property
    def depth_range_m(self) -> tuple[float, float]:
        low, high = self.settings["depth_range_m"]
        return float(low), float(high)

    @property
    def camera(self) -> Intrinsics:
        """Of the pictures that the network was trained on."""
        return Intrinsics(**self.settings["camera"])

    @property
    def past_frames(self) -> PastFrames | None:
        """What its coarse depth was computed from, if not by the robot."""
        count = self.settings.get("past_frames", 0)
        return PastFrames(count, self.settings["past_gap"]) if count else None

    def build(self) -> nn.Module:
        """The network with its weights, for use."""
        network = build_network(self.network, self.depth_range_m, 0)
        network.load_state_dict(self.weights)
        return network.eval()


def write_atomically(data: bytes, file: Path) -> None:
    """The old file stays until the new one is complete on the disk."""
    partial = file.with_name(file.name + ".partial")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, file)
    except OSError as problem:
        partial.unlink(missing_ok=True)
        kept = f"; the older {file.name} is untouched" if file.exists() else ""
        raise TrainerError(f"cannot write {file}: {problem}{kept}; make room or give another --out") from problem


def save(checkpoint: Checkpoint, file: Path) -> None:
    # In memory first: PyTorch's own writer leaves a torn file when the disk is full.
    stream = io.BytesIO()
    torch.save({"format_version": FORMAT_VERSION, **vars(checkpoint)}, stream)
    write_atomically(stream.getvalue(), file)


def load(file: Path) -> Checkpoint:
    try:
        # Nothing in the file is executed.
        loaded = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise TrainerError(f"{file} does not exist; give the checkpoint.pt of a training") from None
    except Exception as problem:
        raise TrainerError(f"{file} is no checkpoint: {problem}; train again or give another") from problem
    if not isinstance(loaded, dict) or loaded.get("format_version") != FORMAT_VERSION:
        raise TrainerError(f"{file} is no checkpoint of version {FORMAT_VERSION}; train again with this trainer")
    del loaded["format_version"]
    return Checkpoint(**loaded)
