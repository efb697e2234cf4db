"""The depth networks by their names, with one way to call them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .errors import TrainerError
from .manydepth import ManyDepth
from .networks import Edn, Monodepth2, Padding
from .student import Student

DEPTH_NETWORKS = ("student", "monodepth2_r18", "sc_depth_r18", "manydepth_r18", "edn_r18", "edn_r18_concat")
# What a network's size must be a multiple of.
SIZE_STEP = 32


def build_network(name: str, depth_range_m: tuple[float, float], seed: int, padding: Padding = "zeros") -> nn.Module:
    """A network with the random weights that the seed gives. The student's padding is always zeros."""
    torch.manual_seed(seed)
    if name == "student":
        return Student(depth_range_m)
    if name in ("monodepth2_r18", "sc_depth_r18"):
        return Monodepth2(padding)
    if name == "manydepth_r18":
        return ManyDepth(padding)
    if name in ("edn_r18", "edn_r18_concat"):
        return Edn("concat" if name.endswith("concat") else "add", padding)
    raise TrainerError(f"`{name}` is no network; give one of {', '.join(DEPTH_NETWORKS)}")


def takes_coarse(network: nn.Module) -> bool:
    return not isinstance(network, Monodepth2 | ManyDepth)


def output_of(network: nn.Module, rgb: Tensor, second: Tensor) -> tuple[Tensor, Tensor | None]:
    """x in 0..1 [B, 1, H, W] of any network, and of one that says it, ln of the Laplace scale of the error of ln depth.
    `second` is coarse depth [B, 3, H, W] or a cost volume; a network of pictures alone ignores it."""
    output: Tensor = network(rgb) if isinstance(network, Monodepth2) else network(rgb, second)
    return (output[:, :1], output[:, 1:]) if output.shape[1] == 2 else (output, None)
