"""Checks of a network that comes from elsewhere, before it is used here.

They are those of the robot's gate that need no recording: the form of the file, and the golden pair. The gate makes
them again after the signature, in a process with limits, and measures the network on the robot's frames
(docs/models.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
from google.protobuf.message import Message

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.golden import at_block_centres, golden_inputs, golden_output
from embodied_depth_trainer.networks.runtime import OnnxNetwork

# The same as in the robot's gate: `runtime/src/model_gate/onnx_file.rs` and `firmware-host/src/model/examine.rs`.
OPSETS = range(11, 22)
DOMAINS = ("", "ai.onnx", "ai.onnx.ml")
GOLDEN_TOLERANCE = 1e-2


def examine(file: Path) -> float:
    """Refuses a file that no gate would accept. Returns the difference from its golden output."""
    _check_form(file)
    network = OnnxNetwork(file)
    try:
        difference = _golden_difference(network)
    except Exception as problem:
        # Metadata from elsewhere may be anything, and the kinds of ONNX Runtime's exceptions differ between versions.
        raise TrainerError(
            f"{file} has no usable golden pair ({problem!r}); export it with `embodied-depth export`"
        ) from None
    # `not <=` instead of `>`, so that NaN fails as well.
    if not difference <= GOLDEN_TOLERANCE:
        raise TrainerError(
            f"{file} differs from its golden output by {difference:.2e}, allowed {GOLDEN_TOLERANCE}: it computes "
            "something else here than at its export; ask for the file again, or update ONNX Runtime"
        )
    return difference


def _check_form(file: Path) -> None:
    try:
        # Weights in other files are refused and not read.
        model = onnx.load(str(file), load_external_data=False)
    except Exception as problem:
        raise TrainerError(f"{file} is not an ONNX file: {problem}; ask for the file again") from None
    versions = {entry.domain: entry.version for entry in model.opset_import}
    foreign = sorted(versions.keys() - set(DOMAINS))
    opset = versions.get("", versions.get("ai.onnx", 0))
    outside = next((tensor.name for tensor in _tensors(model) if tensor.external_data or tensor.data_location), None)
    if foreign:
        raise TrainerError(f"{file} needs operators of `{foreign[0]}`; only ONNX's own operators are accepted")
    if opset not in OPSETS:
        raise TrainerError(
            f"{file} has opset {opset}, accepted are {OPSETS[0]} to {OPSETS[-1]}; export it with opset 17"
        )
    if outside is not None:
        raise TrainerError(f"{file} keeps the weights `{outside}` in another file; export them into one file")


def _tensors(message: Message) -> Iterator[onnx.TensorProto]:
    """All tensors of a model: weights, constants of nodes, and those of inner graphs."""
    if isinstance(message, onnx.TensorProto):
        yield message
        return
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in [value] if isinstance(value, Message) else value:
                yield from _tensors(part)


def _golden_difference(network: OnnxNetwork) -> float:
    """Largest difference of x in 0..1 from the golden output."""
    channels = {value.name: value.shape[1] for value in network.session.get_inputs()}
    # The golden input is in the order of the kind.
    ordered = {name: channels[name] for name in network.metadata["kind"].split("+")}
    inputs = golden_inputs(network.metadata, ordered, network.size)
    output = network.session.run(None, {name: plane.numpy() for name, plane in inputs.items()})[0]
    return float(np.abs(at_block_centres(output[0, 0]) - golden_output(network.metadata, network.size)).max())
