"""Converts the names of princeton-vl's RAFT weights to torchvision's.

Both are the same network (Teed and Deng 2020); torchvision groups a convolution with its norm and names the parts
differently. https://github.com/princeton-vl/RAFT publishes its weights under BSD-3.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import Tensor

from embodied_depth_trainer.export.onnx_writer import ExportError

_ENCODERS = {"fnet": "feature_encoder", "cnet": "context_encoder"}
# Parts of the update block; `mask` exists in the large network only.
_UPDATE = [
    (r"encoder\.convc(\d)\.", r"update_block.motion_encoder.convcorr\1.0."),
    (r"encoder\.convf(\d)\.", r"update_block.motion_encoder.convflow\1.0."),
    (r"encoder\.conv\.", r"update_block.motion_encoder.conv.0."),
    (r"gru\.conv([zrq])(\d)\.", r"update_block.recurrent_block.convgru\2.conv\1."),
    (r"gru\.conv([zrq])\.", r"update_block.recurrent_block.convgru1.conv\1."),
    (r"flow_head\.", r"update_block.flow_head."),
    (r"mask\.0\.", r"mask_predictor.convrelu.0."),
    (r"mask\.2\.", r"mask_predictor.conv."),
]
_ENCODER = [
    (r"conv1\.", "convnormrelu.0."),
    (r"norm1\.", "convnormrelu.1."),
    (r"conv2\.", "conv."),
    (r"(layer\d\.\d)\.conv(\d)\.", r"\1.convnormrelu\2.0."),
    (r"(layer\d\.\d)\.norm(\d)\.", r"\1.convnormrelu\2.1."),
    (r"(layer\d\.\d)\.downsample\.(\d)\.", r"\1.downsample.\2."),
]


def is_princeton(weights: Mapping[str, Tensor]) -> bool:
    """princeton-vl saved the network inside a `DataParallel`, which prefixes the names."""
    return any(name.startswith(("module.", "fnet.")) for name in weights)


def from_princeton(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The same weights under torchvision's names. Every weight is used; an unknown one is an error."""
    plain = {name.removeprefix("module."): value for name, value in weights.items()}
    mapped: dict[str, Tensor] = {}
    for name, value in plain.items():
        if (twin := _twin(name, plain)) is not None:
            # The same norm is saved under two names; the second name is the one that is mapped.
            if not torch.equal(value, plain[twin]):
                raise ExportError(
                    f"the RAFT weights `{name}` and `{twin}` are the same norm but differ; the file is damaged"
                )
            continue
        new = torchvision_name(name)
        if new in mapped:
            raise ExportError(f"two RAFT weights map to `{new}`, the second is `{name}`; the file is damaged")
        mapped[new] = value
    return mapped


def _twin(name: str, weights: Mapping[str, Tensor]) -> str | None:
    """The second name of a block's shortcut norm, which is also saved as the block's last norm."""
    match = re.fullmatch(r"(.*layer\d\.\d)\.norm([34])\.(.*)", name)
    if match is None:
        return None
    block, number, rest = match.groups()
    # The last norm: the fourth of a bottleneck block, the third of a residual block.
    last = "4" if f"{block}.conv3.weight" in weights else "3"
    twin = f"{block}.downsample.1.{rest}"
    return twin if number == last and twin in weights else None


def torchvision_name(name: str) -> str:
    """torchvision's name of one of princeton-vl's weights (without `module.`)."""
    part, _, rest = name.partition(".")
    rules, prefix = (_UPDATE, "") if part == "update_block" else (_ENCODER, f"{_ENCODERS.get(part, '?')}.")
    if prefix != "?.":
        for old, new in rules:
            if (match := re.match(old, rest)) is not None:
                return prefix + match.expand(new) + rest[match.end() :]
    raise ExportError(
        f"the RAFT weight `{name}` does not exist in torchvision's network; the file may be of another version of RAFT"
    )
