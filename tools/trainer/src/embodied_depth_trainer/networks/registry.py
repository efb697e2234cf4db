"""Builds the depth networks by name and calls them in a uniform way."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.edn import Edn
from embodied_depth_trainer.networks.manydepth import ManyDepth
from embodied_depth_trainer.networks.monodepth2 import Monodepth2
from embodied_depth_trainer.networks.resnet import Decoder, Padding
from embodied_depth_trainer.networks.student import Student

DEPTH_NETWORKS = ("student", "monodepth2_r18", "sc_depth_r18", "manydepth_r18", "edn_r18", "edn_r18_concat")
# Image sizes must be multiples of this.
SIZE_STEP = 32
# Depth that untrained ResNet18 networks predict. The middle of x in 0..1 is 20 cm, where two frames of a home have
# nothing in common. Training then overshoots to infinite depth, where ManyDepth remained.
INITIAL_DEPTH_M = 2.5


def build_network(name: str, depth_range_m: tuple[float, float], seed: int, padding: Padding = "zeros") -> nn.Module:
    """A network with random weights that follow from the seed. The student always pads with zeros."""
    torch.manual_seed(seed)
    if name == "student":
        return Student(depth_range_m)
    network: nn.Module
    if name in ("monodepth2_r18", "sc_depth_r18"):
        network = Monodepth2(padding)
    elif name == "manydepth_r18":
        network = ManyDepth(padding)
    elif name in ("edn_r18", "edn_r18_concat"):
        network = Edn("concat" if name.endswith("concat") else "add", padding)
    else:
        raise TrainerError(f"`{name}` is not a network; give one of {', '.join(DEPTH_NETWORKS)}")
    _set_initial_depth(INITIAL_DEPTH_M, network, depth_range_m)
    return network


def _set_initial_depth(depth_m: float, network: nn.Module, depth_range_m: tuple[float, float]) -> None:
    """Sets the bias of the output so that the untrained network predicts about this depth everywhere."""
    near, far = depth_range_m
    x = (1 / min(max(depth_m, 1.01 * near), 0.99 * far) - 1 / far) / (1 / near - 1 / far)
    for decoder in (module for module in network.modules() if isinstance(module, Decoder)):
        assert decoder.head.bias is not None
        nn.init.constant_(decoder.head.bias, math.log(x / (1 - x)))


def takes_coarse(network: nn.Module) -> bool:
    return not isinstance(network, Monodepth2 | ManyDepth)


def output_of(network: nn.Module, rgb: Tensor, second: Tensor) -> tuple[Tensor, Tensor | None]:
    """Runs any network: x in 0..1 [B, 1, H, W] and, for a network that predicts it, ln of the Laplace scale of the
    error of ln depth. `second` is coarse depth [B, 3, H, W] or a cost volume; networks that take only an image ignore
    it."""
    output: Tensor = network(rgb) if isinstance(network, Monodepth2) else network(rgb, second)
    return (output[:, :1], output[:, 1:]) if output.shape[1] == 2 else (output, None)
