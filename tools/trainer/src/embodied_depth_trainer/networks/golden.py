"""A golden pair in the model file: an input, and the network's output for it at export.

When a model is installed, its output is compared with the golden output, which detects a file, a runtime or a
processor that computes something else before the robot drives by it. A full input would double the size of the file,
so it is made of blocks:

`golden_input`: base64 of uint8 [channels, rows / 16, columns / 16]. Each value v is 16x16 pixels of v / 255. The
inputs follow each other in the order of `kind`, three channels each; for a cost volume it is all planes, in cells of
4x4 pixels.

`golden_output`: base64 of little-endian float32 [rows / 16, columns / 16], the output at rows 16 i + 8 and columns 16
j + 8.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from embodied_depth_trainer.networks.cost_volume import REDUCTION

BLOCK = 16
CHANNELS = 3
GOLDEN_SEED = 7


def golden_pair(network: nn.Module, inputs: Mapping[str, Tensor], size: tuple[int, int]) -> dict[str, str]:
    """The metadata of the golden pair for a network that takes `inputs` at `size` rows x columns."""
    rows = size[0] // BLOCK
    columns = size[1] // BLOCK
    channels = {name: plane.shape[1] for name, plane in inputs.items()}
    blocks = np.random.default_rng(GOLDEN_SEED).integers(0, 256, (sum(channels.values()), rows, columns), np.uint8)
    if "coarse" in inputs:
        # The validity of coarse depth is 0 or 1.
        blocks[CHANNELS + 1] = np.where(blocks[CHANNELS + 1] > 127, 255, 0)
    metadata = {"golden_input": base64.b64encode(blocks.tobytes()).decode()}
    with torch.no_grad():
        output = network.eval()(*golden_inputs(metadata, channels, size).values())
    found = at_block_centres(output.numpy()[0, 0])
    return {**metadata, "golden_output": base64.b64encode(found.tobytes()).decode()}


def golden_inputs(metadata: Mapping[str, str], channels: Mapping[str, int], size: tuple[int, int]) -> dict[str, Tensor]:
    """The inputs [1, C, H, W], a volume [1, C, H / 4, W / 4], that the metadata describes."""
    rows = size[0] // BLOCK
    columns = size[1] // BLOCK
    coded = np.frombuffer(base64.b64decode(metadata["golden_input"]), np.uint8)
    blocks = coded.reshape(-1, rows, columns).astype(np.float32) / 255
    ends = np.cumsum(list(channels.values()))[:-1]
    planes = {}
    for (name, _), part in zip(channels.items(), np.split(blocks, ends), strict=True):
        block = BLOCK // REDUCTION if name == "volume" else BLOCK
        planes[name] = torch.from_numpy(part.repeat(block, axis=1).repeat(block, axis=2)[None])
    return planes


def golden_output(metadata: Mapping[str, str], size: tuple[int, int]) -> NDArray[np.float32]:
    """The golden output, [rows / 16, columns / 16]."""
    coded = np.frombuffer(base64.b64decode(metadata["golden_output"]), "<f4")
    return coded.reshape(size[0] // BLOCK, size[1] // BLOCK)


def at_block_centres(
    output: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Samples an output [H, W] at the centres of the blocks."""
    return np.ascontiguousarray(output[BLOCK // 2 :: BLOCK, BLOCK // 2 :: BLOCK]).astype("<f4")
