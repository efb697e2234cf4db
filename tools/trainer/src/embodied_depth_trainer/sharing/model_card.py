"""The card of an exported network: what its file says about itself, and where it says nothing."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import onnx

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.provenance import Provenance
from embodied_depth_trainer.networks.exported import read_metadata
from embodied_depth_trainer.sharing.cards import TAG, UNKNOWN, CardOptions, front_matter, license_section, table
from embodied_depth_trainer.sharing.results_table import results_table
from embodied_depth_trainer.training.history import described

MEANINGS = {
    "rgb": "image: red, green and blue in 0..1",
    "coarse": "{given} depth: x in 0..1 (below), whether there is depth (0 or 1), its confidence in 0..1",
    "volume": "matching cost of planes from {volume_max_depth_m} m to {volume_min_depth_m} m: mean difference of "
    "colours in 0..1, 0 where nothing was seen",
    "image1": "first image: red, green and blue in 0..1",
    "image2": "second image: red, green and blue in 0..1",
    "flow": "motion from the first to the second image in pixels: x (right), y (down)",
}
DEPTH = "depth along the optical axis as x in 0..1"
SCALE = (
    "ln b, where b is the scale of the error of ln depth: depth is within 25 % with probability 1 - exp(-ln 1.25 / b)"
)


def model_card(file: Path, options: CardOptions) -> str:
    """The card in Markdown."""
    return _Card(file, options).text()


class _Card:
    def __init__(self, file: Path, options: CardOptions) -> None:
        self.model, _ = read_metadata(file)
        self.file = file
        self.options = options
        try:
            self.provenance = Provenance(file)
        except ValueError as problem:
            raise TrainerError(f"{file} has damaged metadata ({problem}); export it again") from None
        self.said = self.provenance.metadata
        if "kind" not in self.said:
            raise TrainerError(
                f"{file} does not say of which kind it is; give a file that `embodied-depth export` wrote"
            )

    @property
    def is_flow(self) -> bool:
        return self.said["kind"] == "flow"

    def text(self) -> str:
        sections = [
            self._front_matter(),
            f"# {self.said.get('version', self.file.stem)}",
            self._what(),
            f"## Inputs and outputs\n\n{self._shapes()}\n\n{self._geometry()}",
            f"## Training\n\n{self._training()}",
            *([] if self.is_flow else [f"## Calibration\n\n{self._calibration()}"]),
            f"## Measured\n\n{self._results()}",
            f"## The file\n\n{self._file()}",
            *([] if self.is_flow else [f"## Use\n\n{self._use()}"]),
            license_section(self.options.license),
        ]
        return "\n\n".join(sections) + "\n"

    def _front_matter(self) -> str:
        return front_matter(
            {
                "license": self.options.license,
                "library_name": "onnx",
                "pipeline_tag": None if self.is_flow else "depth-estimation",
                "base_model": self.options.base_model,
                "datasets": self.options.datasets,
                "tags": ["onnx", "robotics", "optical-flow" if self.is_flow else "depth-estimation", TAG],
            }
        )

    def _what(self) -> str:
        task = "the motion between two images" if self.is_flow else "the depth of every pixel in metres"
        return (
            f"A network that predicts {task} on a robot, exported by Embodied Depth. This card was written from the "
            "metadata of the file; where the file says nothing about something, the card says so."
        )

    def _shapes(self) -> str:
        graph = self.model.graph
        rows = [("input", value, self._meaning(value)) for value in graph.input]
        rows += [("output", value, self._meaning(value)) for value in graph.output]
        return table(
            ("", "name", "shape", "content"),
            [(kind, f"`{value.name}`", "x".join(map(str, shape_of(value))), meaning) for kind, value, meaning in rows],
        )

    def _meaning(self, value: onnx.ValueInfoProto) -> str:
        if value.name == "disparity":
            return f"1: {DEPTH}; 2: {SCALE}" if shape_of(value)[1:2] == [2] else DEPTH
        words = {"given": self.said.get("given_depth", "coarse")} | {
            key: self.said.get(key, "?") for key in ("volume_min_depth_m", "volume_max_depth_m")
        }
        return MEANINGS.get(value.name, UNKNOWN).format(**words)

    def _geometry(self) -> str:
        rows = [("size of the images, rows x columns", self._both("input_height", "input_width", "x"))]
        if not self.is_flow:
            rows.append(("depth range, m", self._both("min_depth_m", "max_depth_m", " to ")))
            rows.append(("intrinsics of these images, pixels", self._intrinsics()))
        shown = table(("", ""), rows)
        if "min_depth_m" in self.said and "max_depth_m" in self.said:
            shown += (
                f"\n\nWith near = {self.said['min_depth_m']} m and far = {self.said['max_depth_m']} m, depth is "
                "1 / (1 / far + (1 / near - 1 / far) x)."
            )
        return shown

    def _both(self, first: str, second: str, between: str) -> str:
        return UNKNOWN if not {first, second} <= self.said.keys() else self.said[first] + between + self.said[second]

    def _intrinsics(self) -> str:
        if "intrinsics" not in self.said:
            return UNKNOWN
        return ", ".join(f"{key} = {value:.6g}" for key, value in json.loads(self.said["intrinsics"]).items())

    def _training(self) -> str:
        rows = [("architecture", self.said.get("architecture", UNKNOWN))]
        training = self.provenance.training
        if training is None:
            rows.append(("weights", self.said.get("weights", UNKNOWN)))
            return f"{table(('', ''), rows)}\n\nThe file does not say that a training made it."
        settings = {key: value for key, value in training.items() if key != "steps"}
        rows += [
            ("steps", str(training["steps"])),
            ("began with", self.said.get("parent") or training.get("init", UNKNOWN) or "random weights"),
            *([("image encoder began with", training["encoder"])] if training.get("encoder") else []),
            ("trainer", self.said.get("trainer", UNKNOWN)),
            *(("data", line) for line in described(self.provenance.history or [{"from_step": 0}], training["steps"])),
            ("places, robots and sensors of the data", f"{UNKNOWN}; the card of the dataset may"),
        ]
        return f"{table(('', ''), rows)}\n\nSettings:\n\n```json\n{json.dumps(settings, indent=1)}\n```"

    def _calibration(self) -> str:
        found: dict[str, Any] | None = self.provenance.calibration
        if found is None:
            return "The file does not say that its confidence was calibrated."
        dataset = found.get("dataset")
        where = f"dataset {dataset['version']}" if dataset else f"recordings ({UNKNOWN} which)"
        return (
            f"The predicted ln b was replaced by {found['slope']:.4g} ln b {found['offset']:+.4g}, which was fitted to "
            f"labels of {found['frames']} frames of {where}. Depth was not changed."
        )

    def _results(self) -> str:
        if self.options.results is None:
            return "The file does not say how accurate it is, and no results were given."
        where = self.options.measured_on or "the results do not say which recordings"
        return f"Measured on: {where}.\n\n" + results_table(self.options.results, self.said.get("version", "network"))

    def _file(self) -> str:
        content = self.file.read_bytes()
        opsets = ", ".join(f"{entry.domain or 'ai.onnx'} {entry.version}" for entry in self.model.opset_import)
        has_golden = {"golden_input", "golden_output"} <= self.said.keys()
        rows = [
            ("name", f"`{self.file.name}`"),
            ("size, bytes", len(content)),
            ("SHA-256", f"`{hashlib.sha256(content).hexdigest()}`"),
            ("opset", opsets),
            ("largest difference of ONNX Runtime from PyTorch at export", self.said.get("parity_max_abs", UNKNOWN)),
            ("golden pair", "an input and the output for it are in the metadata" if has_golden else UNKNOWN),
        ]
        if "coarse_from" in self.said:
            rows.append(
                ("coarse depth of the training", f"{self.said['coarse_from']}; the robot computes it otherwise")
            )
        return table(("", ""), rows)

    def _use(self) -> str:
        return (
            "A robot does not trust this file. `push-model` signs it with your key and sends it, and the robot's gate "
            "examines it before the robot drives by it:\n\n"
            f"    embodied-depth hub download OWNER/NAME --out .\n"
            f"    push-model --key workshop.key {self.file.name} robot.local"
        )


def shape_of(value: onnx.ValueInfoProto) -> list[int | str]:
    """The sizes of an input or output; a name where a size is free."""
    return [size.dim_value or size.dim_param for size in value.type.tensor_type.shape.dim]
