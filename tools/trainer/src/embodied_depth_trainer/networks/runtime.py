"""An exported ONNX file as a network, computed by ONNX Runtime, so that it is measured like a checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import Tensor, nn

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.cost_volume import plane_depths

KINDS = ("rgb", "rgb+coarse", "rgb+volume")
NEEDED = ("kind", "min_depth_m", "max_depth_m", "input_width", "input_height")


class OnnxNetwork(nn.Module):
    """Maps `rgb` [N, 3, H, W] and the second input of its kind to what the file computes; H and W are the file's."""

    depths_m: Tensor | None
    """Depths of the planes of its cost volume in metres, for a file that takes one."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        if not file.is_file():
            raise TrainerError(f"{file} does not exist; give an ONNX file of `embodied-depth export`")
        try:
            self.session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        except Exception as problem:
            # The kinds of exception differ between versions of ONNX Runtime.
            raise TrainerError(f"ONNX Runtime cannot load {file}: {problem}; export it again") from None
        self.metadata: dict[str, str] = self.session.get_modelmeta().custom_metadata_map
        missing = [key for key in NEEDED if key not in self.metadata]
        if missing or self.metadata["kind"] not in KINDS:
            raise TrainerError(
                f"{file} is no depth network of this trainer: its metadata lack {missing or 'a known kind'}; "
                "give a file of `embodied-depth export` (for any other model, see `label --teacher`)"
            )
        # The place where its outputs are; the session itself computes on the CPU.
        self.register_buffer("place", torch.zeros(()), persistent=False)
        self.register_buffer("depths_m", self._planes(), persistent=False)

    @property
    def size(self) -> tuple[int, int]:
        """Rows, columns."""
        return int(self.metadata["input_height"]), int(self.metadata["input_width"])

    @property
    def depth_range_m(self) -> tuple[float, float]:
        return float(self.metadata["min_depth_m"]), float(self.metadata["max_depth_m"])

    @property
    def given_depth(self) -> str:
        """The depth that the network is given: `coarse` or `dense`."""
        return self.metadata.get("given_depth", "coarse")

    @property
    def title(self) -> str:
        return self.metadata.get("version", "network")

    def _planes(self) -> Tensor | None:
        if self.metadata["kind"] != "rgb+volume":
            return None
        (volume,) = (value for value in self.session.get_inputs() if value.name == "volume")
        near, far = (float(self.metadata[f"volume_{end}_depth_m"]) for end in ("min", "max"))
        return plane_depths(volume.shape[1], (near, far))

    def forward(self, rgb: Tensor, second: Tensor) -> Tensor:
        if tuple(rgb.shape[2:]) != self.size:
            height, width = self.size
            raise TrainerError(
                f"the images are {rgb.shape[2]}x{rgb.shape[3]}, the model takes {height}x{width}; give frames or views "
                "of that size, or export the model with --size"
            )
        names = self.metadata["kind"].split("+")
        # One image at a time, because the file's batch is 1.
        found = []
        for index in range(len(rgb)):
            planes = (plane[index : index + 1].cpu().numpy() for plane in (rgb, second))
            found.append(self.session.run(None, dict(zip(names, planes, strict=False)))[0])
        return torch.from_numpy(np.concatenate(found)).to(rgb.device)
