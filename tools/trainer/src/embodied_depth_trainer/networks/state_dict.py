"""Reads files of weights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from embodied_depth_trainer.errors import TrainerError


def load_state_dict(file: Path) -> dict[str, Tensor]:
    """Reads a state dict; nothing in the file is executed."""
    try:
        loaded = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise TrainerError(f"{file} does not exist; give a file of weights") from None
    except Exception as problem:
        raise TrainerError(f"{file} is not a file of PyTorch weights: {problem}") from problem
    if not isinstance(loaded, dict) or not all(isinstance(value, Tensor) for value in loaded.values()):
        raise TrainerError(f"{file} holds no state dict; save `network.state_dict()` alone")
    return dict(loaded)


def load_strictly(network: nn.Module, weights: Mapping[str, Tensor], source: str) -> None:
    """Loads the weights; refuses missing and unknown ones."""
    try:
        network.load_state_dict(dict(weights), strict=True)
    except RuntimeError as problem:
        raise TrainerError(f"the weights of {source} do not fit the network: {problem}") from problem
