"""Test views of a scene, which no run contains: the output of `firmware-host views`."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import nn

from embodied_depth_trainer.data.coarse_depth import read_dataset_dump
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.studies.evaluation import Metrics, evaluate

Rows = dict[str, dict[str, dict[str, float]]]
"""Metrics by views (`all`, `drive`, `turn`), by what is evaluated (`constant`, `coarse`, a network) and by name."""


@dataclass(frozen=True)
class Views:
    """The views, which have true and coarse depth, and the frames on the way to them, which have neither."""

    frames: Frames
    rotated: NDArray[np.bool_]
    """[N]; the robot arrived by rotating on the spot, so there is no parallax."""

    @property
    def has_truth(self) -> NDArray[np.bool_]:
        """[N]; true for a view, false for a frame on the way to one."""
        assert self.frames.truth_mm is not None
        return np.asarray(self.frames.truth_mm.any(axis=(1, 2)))

    @staticmethod
    def read(folder: Path) -> Views:
        index = json.loads((folder / "dump.json").read_text())
        rotated = np.array([entry["approach"] == "turn" for entry in index["frames"]])
        return Views(read_dataset_dump(folder), rotated)

    def metrics(
        self, networks: dict[str, nn.Module], depth_range_m: tuple[float, float]
    ) -> dict[str, dict[str, Metrics]]:
        """The metrics of all views, of those with and of those without parallax."""
        parts = {"all": np.ones_like(self.rotated), "drive": ~self.rotated, "turn": self.rotated}
        return {
            part: evaluate(take(self.frames, mask), networks, depth_range_m)
            for part, mask in parts.items()
            if mask.any()
        }

    def evaluate(self, networks: dict[str, nn.Module], depth_range_m: tuple[float, float]) -> Rows:
        """The same as plain types."""
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
        dense=None if frames.dense is None else frames.dense[which],
    )


def _plain(rows: dict[str, Metrics]) -> dict[str, dict[str, float]]:
    return {name: asdict(row) for name, row in rows.items()}
