"""The network that a training begins with: random weights, a checkpoint, or the weights of an exported ONNX file."""

from __future__ import annotations

import hashlib
from pathlib import Path

from torch import nn

from embodied_depth_trainer.data.frame_set import GivenDepth
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.exported import load_exported, read_metadata
from embodied_depth_trainer.networks.registry import build_network
from embodied_depth_trainer.networks.state_dict import load_strictly
from embodied_depth_trainer.training import checkpoint as checkpoints

# The default network of the robot, which the package contains.
SHIPPED = Path(__file__).resolve().parents[1] / "default.onnx"
# The values of --init that stand for random weights and for the default network.
RANDOM = "none"
SHIPPED_NAME = "shipped"
# Batches of the training from which the statistics of batch norms are measured after an ONNX file was loaded.
STATISTICS_BATCHES = 8


def is_exported(file: str) -> bool:
    """Whether the initial weights come from an ONNX file, which has no batch norms."""
    return file.endswith(".onnx")


def load_initial(network: nn.Module, name: str, depth_range_m: tuple[float, float], file: str) -> None:
    """Loads the weights of `file`, a checkpoint or an exported model, into the network called `name`."""
    if is_exported(file):
        load_exported(network, name, depth_range_m, Path(file))
        return
    saved = checkpoints.load(Path(file))
    if (saved.network, saved.depth_range_m) != (name, depth_range_m):
        raise TrainerError(
            f"{file} holds `{saved.network}` for {saved.depth_range_m} m, the training is of `{name}` for "
            f"{depth_range_m} m; give the options of that network, or another file"
        )
    load_strictly(network, saved.weights, file)


def initial_network(name: str, depth_range_m: tuple[float, float], seed: int, file: str | None) -> nn.Module:
    """The network before its training, in evaluation mode: random weights, or those of `file`."""
    network = build_network(name, depth_range_m, seed)
    if file is not None:
        load_initial(network, name, depth_range_m, file)
    return network.eval()


def given_depth(file: str | None) -> GivenDepth:
    """The depth that the network of `file` is given; coarse depth without one."""
    if file is None:
        return "coarse"
    if is_exported(file):
        return "dense" if read_metadata(Path(file))[1].get("given_depth") == "dense" else "coarse"
    return checkpoints.load(Path(file)).given_depth


def identity(file: str | None) -> str | None:
    """Name and digest of the initial weights, as checkpoints store them: the same file may move, another must not
    replace it."""
    if file is None:
        return None
    try:
        digest = hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError as problem:
        raise TrainerError(f"cannot read the initial weights: {problem}; give --init FILE or --init none") from None
    return f"{Path(file).name} sha256:{digest[:16]}"


def chosen(option: str | None) -> str | None:
    """The file that `--init` names; `None` for random weights."""
    if option in (None, RANDOM):
        return None
    return str(SHIPPED) if option == SHIPPED_NAME else option
