"""Writes a network as ONNX, compares ONNX Runtime with PyTorch, and stores metadata in the file."""

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

from embodied_depth_trainer.errors import TrainerError

# GridSample was added in opset 16; opset 17 is what the robot's ONNX Runtime and TensorRT 8.6 read.
OPSET = 17
# Convolutions are summed in another order: a few units in the last place per layer.
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
    """Exports `network`, compares it with PyTorch on `inputs`, and writes `out` completely or not at all. Returns the
    largest difference."""
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
        # The tracer warns about every size that becomes a constant, which is intended: one file, one size.
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
    # `not <=` instead of `>`, so that NaN fails as well.
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


def random_image(size: tuple[int, int], seed: int) -> Tensor:
    """A smooth random image `[1, 3, rows, columns]` in 0..1; noise alone would have no structure to match."""
    height, width = size
    generator = torch.Generator().manual_seed(seed)
    blobs = torch.rand(1, 3, max(2, height // 8), max(2, width // 8), generator=generator)
    return nn.functional.interpolate(blobs, size=size, mode="bilinear", align_corners=False)
