"""What a model was trained on, as the metadata of its file say it.

| key | content |
|---|---|
| `dataset` | version, shards, frames and runs of the dataset that the last steps have read (JSON) |
| `history` | the same for each dataset of the training, and from which step on (JSON); see `training/history.py` |
| `parent` | file name and digest of the weights that the training began with; missing if they were random |
| `trainer` | name and version of the program that made the last steps |
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from embodied_depth_trainer.networks.exported import read_metadata
from embodied_depth_trainer.training.checkpoint import Checkpoint
from embodied_depth_trainer.training.history import Period, described, versions

# What of a period describes its dataset.
OF_PERIOD = ("from_step", "trainer")


def origin(saved: Checkpoint) -> dict[str, str]:
    """The metadata about the origin of a network."""
    found = {"history": json.dumps(saved.history)} if saved.history else {}
    last: Period = saved.history[-1] if saved.history else {}
    if "trainer" in last:
        found["trainer"] = last["trainer"]
    if "version" in last:
        found["dataset"] = json.dumps({key: value for key, value in last.items() if key not in OF_PERIOD})
    if saved.settings.get("init") is not None:
        found["parent"] = saved.settings["init"]
    return found


class Provenance:
    """The origin of the model in an exported file."""

    def __init__(self, file: Path) -> None:
        _, metadata = read_metadata(file)
        self.file = file
        self.metadata: Mapping[str, str] = metadata
        self.history: list[Period] = self._json("history") or []
        self.training: dict[str, Any] | None = self._json("training")
        self.calibration: dict[str, Any] | None = self._json("calibration")

    def _json(self, key: str) -> Any:  # noqa: ANN401
        return json.loads(self.metadata[key]) if key in self.metadata else None

    @property
    def datasets(self) -> list[str]:
        """The names of all datasets that its weights come from."""
        return versions(self.history)

    def lines(self) -> list[str]:
        """The origin in words."""
        size = f"{self.metadata.get('input_height')}x{self.metadata.get('input_width')}"
        lines = [f"{self.file}: {self.metadata.get('architecture', 'unknown network')}, {size}"]
        if self.training is None:
            return [*lines, f"weights: {self.metadata.get('weights', 'unknown')}; the file was made by no training"]
        begin = self.metadata.get("parent") or self.training.get("init")
        lines.append(f"began with: {begin or 'random weights'}")
        if self.training.get("encoder"):
            lines.append(f"image encoder began with: {self.training['encoder']}")
        steps = self.training["steps"]
        lines.append(f"trained for {steps} steps")
        lines += described(self.history or [{"from_step": 0}], steps)
        return [*lines, *self._calibrated()]

    def _calibrated(self) -> list[str]:
        if self.calibration is None:
            return []
        dataset = self.calibration.get("dataset")
        where = f" of dataset {dataset['version']}" if dataset else ""
        return [f"confidence calibrated on {self.calibration['frames']} frames{where}"]
