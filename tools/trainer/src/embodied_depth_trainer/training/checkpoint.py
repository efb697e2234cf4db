"""The state of a training in one file, which is written completely or not at all.

The file holds only tensors and plain containers, no class or module of this package, so it does not depend on the
package's layout.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from embodied_depth_trainer.data.frame_set import GivenDepth
from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.networks.inputs import give
from embodied_depth_trainer.networks.registry import build_network

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """Everything that the next step depends on, except the frames."""

    step: int
    """Number of completed steps."""
    network: str
    settings: dict[str, Any]
    """The settings of the training; resuming with others is refused."""
    weights: dict[str, Tensor]
    optimizer: dict[str, Any]
    history: list[dict[str, Any]] = field(default_factory=list)
    """What the steps have read; see `history.py`. Empty in files of earlier versions."""

    @property
    def depth_range_m(self) -> tuple[float, float]:
        low, high = self.settings["depth_range_m"]
        return float(low), float(high)

    @property
    def camera(self) -> Intrinsics:
        """The camera of the images that the network was trained on."""
        return Intrinsics(**self.settings["camera"])

    @property
    def past_frames(self) -> PastFrames | None:
        """The past frames that coarse depth was computed from; `None` if it was the robot's own."""
        count = self.settings.get("past_frames", 0)
        return PastFrames(count, self.settings["past_gap"]) if count else None

    @property
    def given_depth(self) -> GivenDepth:
        """The depth that the network is given."""
        return "dense" if self.settings.get("given_depth") == "dense" else "coarse"

    def build(self) -> nn.Module:
        """The network with its weights, in evaluation mode."""
        network = build_network(self.network, self.depth_range_m, 0)
        network.load_state_dict(self.weights)
        return give(network.eval(), self.given_depth)


def save(checkpoint: Checkpoint, file: Path) -> None:
    # Serialised in memory first, because PyTorch's own writer leaves a truncated file when the disk is full.
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
        # PyTorch adds paragraphs about its own options, which do not help here.
        reason = next(iter(str(problem).splitlines()), type(problem).__name__)
        raise TrainerError(f"{file} is not a checkpoint: {reason}; train again or give another file") from problem
    if not isinstance(loaded, dict) or loaded.get("format_version") != FORMAT_VERSION:
        raise TrainerError(f"{file} is not a checkpoint of version {FORMAT_VERSION}; train again with this trainer")
    del loaded["format_version"]
    return Checkpoint(**loaded)
