"""Writes a network as ONNX, compares ONNX Runtime with PyTorch, and puts into the file what it is."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from .errors import TrainerError

# GridSample came with opset 16; 17 is what the robot's ONNX Runtime and TensorRT 8.6 read.
OPSET = 17
# Convolutions are summed in another order: a few units in the last place a layer.
PARITY_TOLERANCE = 1e-3


class ExportError(TrainerError):
    """The network cannot be exported; the text says why and what to do."""


def write_onnx(
    network: nn.Module,
    inputs: Mapping[str, Tensor],
    output: str,
    metadata: Mapping[str, str],
    out: Path,
) -> float:
    """Exports `network`, checks it on `inputs`, writes `out` whole or not at all; returns the largest difference."""
    network.eval()
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        file = Path(folder) / "model.onnx"
        _trace(network, inputs, output, file)
        difference = _difference(network, inputs, file)
        _describe(file, {**metadata, "opset": str(OPSET), "parity_max_abs": f"{difference:.3e}"})
        os.replace(file, out)
    return difference


def _trace(network: nn.Module, inputs: Mapping[str, Tensor], output: str, file: Path) -> None:
    with warnings.catch_warnings(), torch.no_grad():
        # The tracer warns of every size that becomes a constant, which is what we want: one file, one size.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            tuple(inputs.values()),
            str(file),
            input_names=list(inputs),
            output_names=[output],
            opset_version=OPSET,
            dynamo=False,
        )


def _difference(network: nn.Module, inputs: Mapping[str, Tensor], file: Path) -> float:
    """Largest absolute difference between ONNX Runtime and PyTorch on `inputs`."""
    with torch.no_grad():
        expected = network(*inputs.values()).numpy()
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    found = session.run(None, {name: value.numpy() for name, value in inputs.items()})[0]
    difference = float(np.abs(found - expected).max())
    allowed = PARITY_TOLERANCE * max(1.0, float(np.abs(expected).max()))
    # Not `>`: NaN is no parity either.
    if not difference <= allowed:
        raise ExportError(
            f"ONNX Runtime {onnxruntime.__version__} differs from PyTorch {torch.__version__} by {difference}, "
            f"allowed {allowed}; try another version of either"
        )
    return difference


def _describe(file: Path, metadata: Mapping[str, str]) -> None:
    model = onnx.load(str(file))
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model)
    onnx.save(model, str(file))


def load_state_dict(file: Path) -> dict[str, Tensor]:
    """A state dict from a file of tensors only: nothing in the file is executed."""
    try:
        loaded = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise ExportError(f"{file} does not exist; give the file of the weights") from None
    except Exception as problem:
        raise ExportError(f"{file} is no file of PyTorch weights: {problem}") from problem
    if not isinstance(loaded, dict) or not all(isinstance(value, Tensor) for value in loaded.values()):
        raise ExportError(f"{file} holds no state dict; save `network.state_dict()` alone")
    return dict(loaded)


def load_strictly(network: nn.Module, weights: Mapping[str, Tensor], source: str) -> None:
    """Every weight has a place and every place a weight."""
    try:
        network.load_state_dict(dict(weights), strict=True)
    except RuntimeError as problem:
        raise ExportError(f"the weights of {source} do not fit the network: {problem}") from problem


def random_picture(size: tuple[int, int], seed: int) -> Tensor:
    """A smooth random picture `[1, 3, rows, columns]` in 0..1: noise alone has no structure to follow."""
    height, width = size
    generator = torch.Generator().manual_seed(seed)
    blobs = torch.rand(1, 3, max(2, height // 8), max(2, width // 8), generator=generator)
    return nn.functional.interpolate(blobs, size=size, mode="bilinear", align_corners=False)
