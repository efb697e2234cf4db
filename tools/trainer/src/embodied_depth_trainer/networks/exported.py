"""Loads the weights of an exported ONNX file into a network, so that a training can go on from it.

The export folds every batch norm into the convolution before it, which leaves a weight and a bias. Here the
convolution receives the folded weight, and its batch norm the folded bias and the statistics 0 and 1: in evaluation
mode the network computes what the file computes. In training mode a batch norm uses the statistics of the batch, which
are others: `restore_statistics` measures them, and changes scale and bias so that the result stays the same. A
calibration of the confidence is no part of the weights: the training goes on from the uncalibrated confidence.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.golden import at_block_centres, golden_inputs, golden_output

# Largest difference of x in 0..1 between the loaded network and the file's golden output: other orders of summation.
GOLDEN_TOLERANCE = 1e-4
# Names of an architecture's inputs and their channels, for the golden pair.
CHANNELS = {"rgb": 3, "coarse": 3}


def read_metadata(file: Path) -> tuple[onnx.ModelProto, dict[str, str]]:
    """The model and its metadata."""
    try:
        model = onnx.load(str(file))
    except FileNotFoundError:
        raise TrainerError(f"{file} does not exist; give an ONNX file that `embodied-depth export` wrote") from None
    except Exception as problem:
        # The parser of protocol buffers has exceptions of its own.
        raise TrainerError(f"{file} is not an ONNX file: {problem}; give one of `embodied-depth export`") from None
    return model, {entry.key: entry.value for entry in model.metadata_props}


def load_exported(network: nn.Module, architecture: str, depth_range_m: tuple[float, float], file: Path) -> None:
    """Loads the weights of `file` into `network`, whose name is `architecture`, and compares the network with the
    file's golden output. Leaves the network in evaluation mode."""
    model, metadata = read_metadata(file)
    near, far = depth_range_m
    wanted = {"architecture": architecture, "min_depth_m": repr(near), "max_depth_m": repr(far)}
    for key, value in wanted.items():
        if metadata.get(key) != value:
            raise TrainerError(
                f"{file} has {key} = {metadata.get(key)}, the training {value}; "
                "give the options of that network, or another file"
            )
    network.eval()
    weights = _convolutions(model)
    modules = {name: module for name, module in network.named_modules() if isinstance(module, nn.Conv2d)}
    if weights.keys() != modules.keys():
        odd = sorted(weights.keys() ^ modules.keys())
        raise TrainerError(
            f"{file} does not have the convolutions of `{architecture}`: {odd[0]} and {len(odd) - 1} more are only in "
            "one of the two; give a checkpoint.pt instead"
        )
    with torch.no_grad():
        norms = _norms_of_convolutions(network, metadata)
        for name, convolution in modules.items():
            _load(file, name, convolution, norms.get(convolution), *weights[name])
    _check(network, metadata, file)


def module_name(node: str) -> str:
    """The name of the module that an exported node belongs to. The exporter writes a path of attributes, in which the
    members of a container repeat its name: `/down.0/down.0.1/block/block.0/Conv` is `down.0.1.block.0`."""
    names: list[str] = []
    for part in node.strip("/").split("/")[:-1]:
        if names and part.startswith(names[-1] + "."):
            names[-1] = part
        else:
            names.append(part)
    return ".".join(names)


def _convolutions(model: onnx.ModelProto) -> dict[str, tuple[Tensor, Tensor | None]]:
    """Weight and bias of every convolution with learnt weights, by its module's name."""
    values = {value.name: value for value in model.graph.initializer}
    for node in model.graph.node:
        # The exporter stores equal values once.
        if node.op_type == "Identity" and node.input[0] in values:
            values[node.output[0]] = values[node.input[0]]
    found: dict[str, tuple[Tensor, Tensor | None]] = {}
    for node in model.graph.node:
        # The student's upsampling is a convolution with a constant.
        if node.op_type == "Conv" and node.input[1] in values:
            weight, *bias = (torch.from_numpy(numpy_helper.to_array(values[name]).copy()) for name in node.input[1:])
            found[module_name(node.name)] = weight, bias[0] if bias else None
    return found


def _norms_of_convolutions(network: nn.Module, metadata: dict[str, str]) -> dict[nn.Module, nn.BatchNorm2d]:
    """The batch norm that receives the output of each convolution, found by running the network once."""
    made_by: dict[int, tuple[Tensor, nn.Module]] = {}
    norms: dict[nn.Module, nn.BatchNorm2d] = {}

    def remember(module: nn.Module, _: Any, output: Tensor) -> None:  # noqa: ANN401
        # The tensor is kept, so that no other one gets its identity.
        made_by[id(output)] = output, module

    def join(module: nn.BatchNorm2d, inputs: tuple[Tensor]) -> None:
        norms[made_by[id(inputs[0])][1]] = module

    hooks = [m.register_forward_hook(remember) for m in network.modules() if isinstance(m, nn.Conv2d)]
    hooks += [m.register_forward_pre_hook(join) for m in network.modules() if isinstance(m, nn.BatchNorm2d)]
    network(*(torch.zeros(1, CHANNELS[name], 32, 32) for name in metadata["kind"].split("+")))
    for hook in hooks:
        hook.remove()
    return norms


def _load(
    file: Path, name: str, convolution: nn.Conv2d, norm: nn.BatchNorm2d | None, weight: Tensor, bias: Tensor | None
) -> None:
    """Loads one convolution; its batch norm then adds the folded bias and does nothing else."""
    if weight.shape != convolution.weight.shape:
        raise TrainerError(
            f"{file}: `{name}` is {tuple(weight.shape)}, the network's {tuple(convolution.weight.shape)}; "
            "the file is of another version of the network"
        )
    convolution.weight.copy_(weight)
    if norm is None:
        if bias is not None and convolution.bias is not None:
            convolution.bias.copy_(bias)
        return
    assert norm.running_mean is not None
    assert norm.running_var is not None
    norm.running_mean.zero_()
    norm.running_var.fill_(1.0)
    norm.weight.fill_((1 + norm.eps) ** 0.5)
    norm.bias.copy_(torch.zeros_like(norm.bias) if bias is None else bias)


def _check(network: nn.Module, metadata: dict[str, str], file: Path) -> None:
    """Refuses a file whose golden output the network does not reproduce, because it computes something else."""
    size = int(metadata["input_height"]), int(metadata["input_width"])
    channels = {name: CHANNELS[name] for name in metadata["kind"].split("+")}
    with torch.no_grad():
        output = network(*golden_inputs(metadata, channels, size).values())
    difference = float(np.abs(at_block_centres(output.numpy()[0, 0]) - golden_output(metadata, size)).max())
    # `not <=` instead of `>`, so that NaN fails as well.
    if not difference <= GOLDEN_TOLERANCE:
        raise TrainerError(
            f"the network with the weights of {file} differs from the file's golden output by {difference:.2e}, "
            f"allowed {GOLDEN_TOLERANCE}; the file is of another version of the network, give a newer one"
        )


def restore_statistics(network: nn.Module, inputs: Iterable[tuple[Tensor, ...]]) -> None:
    """Replaces the statistics of every batch norm by those of its input for `inputs`, and changes its scale and bias so
    that the network computes the same as before in evaluation mode: then training mode begins there too."""
    sums: dict[nn.BatchNorm2d, list[Tensor]] = {}

    def add(module: nn.BatchNorm2d, given: tuple[Tensor]) -> None:
        x = given[0].double()
        new = [x.sum((0, 2, 3)), (x * x).sum((0, 2, 3)), torch.tensor(x.numel() / x.shape[1], dtype=x.dtype)]
        sums[module] = [old + value for old, value in zip(sums[module], new, strict=True)] if module in sums else new

    network.eval()
    hooks = [m.register_forward_pre_hook(add) for m in network.modules() if isinstance(m, nn.BatchNorm2d)]
    with torch.no_grad():
        for planes in inputs:
            network(*planes)
        for hook in hooks:
            hook.remove()
        for norm, (total, squares, count) in sums.items():
            mean = total / count
            _set_statistics(norm, mean, (squares / count - mean * mean).clamp(min=0.0))


def _set_statistics(norm: nn.BatchNorm2d, mean: Tensor, variance: Tensor) -> None:
    assert norm.running_mean is not None
    assert norm.running_var is not None
    # What the batch norm computes now: scale x + shift.
    scale = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
    shift = norm.bias.double() - scale * norm.running_mean.double()
    norm.running_mean.copy_(mean)
    norm.running_var.copy_(variance)
    norm.weight.copy_(scale * (norm.running_var.double() + norm.eps).sqrt())
    norm.bias.copy_(shift + scale * norm.running_mean.double())


# Share of a batch in the statistics that evaluation uses, for a network that has statistics already. With PyTorch's 0.1
# they are those of the last ten batches, and a validation loss was .1058 after 600 steps; with this one it was .1033.
# In both trainings it still rose by 2 to 4 % over the last 60 steps, in which the weights hardly changed.
MOMENTUM = 0.01


def average_longer(network: nn.Module) -> None:
    """Makes batch norms average their statistics over a hundred batches instead of ten."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.momentum = MOMENTUM
