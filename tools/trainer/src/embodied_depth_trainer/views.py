"""Test views of a scene, held apart from every run: what `firmware-host views` writes."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import nn

from .coarse import read_dataset_dump
from .evaluation import Metrics, evaluate
from .frames import Frames

Rows = dict[str, dict[str, dict[str, float]]]
"""Of which views (`all`, `drive`, `turn`), of what (`constant`, `coarse`, a network), which metric."""


@dataclass(frozen=True)
class Views:
    """Pictures with true and with coarse depth, and without either the pictures that were seen on the way to them."""

    frames: Frames
    turned: NDArray[np.bool_]
    """[N]; the robot came there by turning on the spot: no parallax."""

    @property
    def judged(self) -> NDArray[np.bool_]:
        """[N]; not on the way, but the view itself."""
        assert self.frames.truth_mm is not None
        return np.asarray(self.frames.truth_mm.any(axis=(1, 2)))

    @staticmethod
    def read(folder: Path) -> Views:
        index = json.loads((folder / "dump.json").read_text())
        turned = np.array([entry["approach"] == "turn" for entry in index["frames"]])
        return Views(read_dataset_dump(folder), turned)

    def metrics(
        self, networks: dict[str, nn.Module], depth_range_m: tuple[float, float]
    ) -> dict[str, dict[str, Metrics]]:
        """Of all views, of those with and of those without parallax."""
        parts = {"all": np.ones_like(self.turned), "drive": ~self.turned, "turn": self.turned}
        return {
            part: evaluate(take(self.frames, mask), networks, depth_range_m)
            for part, mask in parts.items()
            if mask.any()
        }

    def evaluate(self, networks: dict[str, nn.Module], depth_range_m: tuple[float, float]) -> Rows:
        """The same in plain types."""
        return {part: _plain(rows) for part, rows in self.metrics(networks, depth_range_m).items()}


def take(frames: Frames, which: NDArray[np.bool_]) -> Frames:
    """The frames where `which` [N] is true."""
    return replace(
        frames,
        rgb=frames.rgb[which],
        t_world_camera=frames.t_world_camera[which],
        time_ns=frames.time_ns[which],
        run=frames.run[which],
        truth_mm=None if frames.truth_mm is None else frames.truth_mm[which],
        coarse=None if frames.coarse is None else frames.coarse[which],
    )


def _plain(rows: dict[str, Metrics]) -> dict[str, dict[str, float]]:
    return {name: asdict(row) for name, row in rows.items()}
