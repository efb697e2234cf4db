"""Calibrates a student's confidence on homes that its weights were not trained on.

A student trained on some homes is overconfident in others. Recordings of further homes, with their own labels,
determine by how much: two numbers, slope and offset of ln b, where b is the predicted Laplace scale. Depth does not
change. No ground truth is used; the labels are computed from the robot's recordings.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper

from embodied_depth_trainer.data.batches import coarse_planes, depth_planes, rgb_planes, to_depth
from embodied_depth_trainer.data.frame_set import FrameSet, giving
from embodied_depth_trainer.data.labels import CELL
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.networks.student import SCALES, UNCONFIRMED_SCALE

# Depth within 25 % of the truth is correct, as for the metric delta1.
LN_TOLERANCE = math.log(1.25)
# Bins of ln b: the fit needs no finer resolution of millions of cells.
BINS = 400


@dataclass(frozen=True)
class Calibration:
    """Replaces ln b by slope ln b + offset."""

    slope: float
    offset: float


@dataclass(frozen=True)
class Counts:
    """How often a network was correct, by the ln b that it predicted; the weights are the labels' confidences."""

    log_scale: NDArray[np.float64]
    """[BINS], the middle of each bin."""
    right: NDArray[np.float64]
    wrong: NDArray[np.float64]


def observe(model: Path, frames: FrameSet) -> Counts:
    """Runs `model` on frames with labels, one at a time because the model's batch is 1."""
    if frames.labels is None or frames.coarse is None:
        raise TrainerError("calibration needs coarse depth and labels; prepare the recordings with both")
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    range_m = (float(metadata["min_depth_m"]), float(metadata["max_depth_m"]))
    given = giving(frames, "dense" if metadata.get("given_depth") == "dense" else "coarse")
    low = math.log(SCALES[0])
    high = math.log(SCALES[1])
    counts = np.zeros((2, BINS))
    middle = CELL // 2
    for index in np.arange(len(frames))[:, None]:
        inputs = {"rgb": rgb_planes(frames, index), "coarse": coarse_planes(given, index, range_m)}
        found = session.run(None, {name: plane.numpy() for name, plane in inputs.items()})[0]
        if found.shape[1] != 2:
            raise TrainerError(f"{model} does not predict the scale of its error and cannot be calibrated")
        output = torch.from_numpy(found[:, :, middle::CELL, middle::CELL])
        label_m, confidence = depth_planes(frames.labels, index).unbind(1)
        error = (to_depth(output[:, 0], range_m).log() - label_m.clamp(min=1e-3).log()).abs()
        place = ((output[:, 1] - low) / (high - low) * BINS).long().clamp(0, BINS - 1)
        for row, kind in enumerate((error < LN_TOLERANCE, error >= LN_TOLERANCE)):
            weight = confidence * kind * (label_m > 0)
            counts[row] += np.bincount(place.flatten().numpy(), weight.flatten().double().numpy(), BINS)
    middles = low + (np.arange(BINS) + 0.5) * (high - low) / BINS
    return Counts(middles, counts[0], counts[1])


def fit(counts: Counts) -> Calibration:
    """The maximum-likelihood slope and offset. At the scale of depth that motion has not confirmed, confidence must
    not grow."""
    x, right, wrong = (torch.from_numpy(values) for values in (counts.log_scale, counts.right, counts.wrong))
    if not (right.sum() > 0 and wrong.sum() > 0):
        raise TrainerError("the labels agree with the network always or never; calibrate on more recordings")
    numbers = torch.tensor([1.0, 0.0], dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([numbers], max_iter=200, line_search_fn="strong_wolfe")

    def negative_log_likelihood() -> torch.Tensor:
        optimizer.zero_grad()
        log_wrong = (-LN_TOLERANCE * torch.exp(-(numbers[0] * x + numbers[1]))).clamp(max=-1e-9)
        log_right = torch.log(-torch.expm1(log_wrong))
        loss = -(right * log_right + wrong * log_wrong).sum() / (right + wrong).sum()
        loss.backward()  # type: ignore[no-untyped-call]
        return loss

    optimizer.step(negative_log_likelihood)  # type: ignore[no-untyped-call]
    slope, offset = (float(value) for value in numbers.detach())
    # At UNCONFIRMED_SCALE, ln b must not shrink.
    return Calibration(slope, max(offset, (1 - slope) * math.log(UNCONFIRMED_SCALE)))


def apply(
    model: Path, calibration: Calibration, frames: int, out: Path, dataset: Mapping[str, Any] | None = None
) -> None:
    """Writes `model` with the calibration as part of its graph, and with the summary of the dataset that it is from.
    Depth, and so the golden pair, stays bit-identical."""
    graph_of = onnx.load(str(model))
    graph = graph_of.graph
    last = graph.node[-1]
    metadata = {entry.key: entry.value for entry in graph_of.metadata_props}
    if last.op_type != "Concat" or len(last.input) != 2 or "calibration" in metadata:
        raise TrainerError(f"{model} is not an uncalibrated student; export it again and calibrate that file")
    predicted = last.input[1]
    for name, value in (("slope", calibration.slope), ("offset", calibration.offset)):
        graph.initializer.append(helper.make_tensor(f"calibration_{name}", TensorProto.FLOAT, [], [value]))
    del graph.node[-1]
    graph.node.append(helper.make_node("Mul", [predicted, "calibration_slope"], ["calibration_scaled"]))
    graph.node.append(helper.make_node("Add", ["calibration_scaled", "calibration_offset"], ["calibrated"]))
    last.input[1] = "calibrated"
    graph.node.append(last)
    metadata["version"] += "-calibrated"
    metadata["calibration"] = json.dumps(
        {**vars(calibration), "frames": frames, **({} if dataset is None else {"dataset": dataset})}
    )
    helper.set_model_props(graph_of, metadata)
    onnx.checker.check_model(graph_of)
    write_atomically(graph_of.SerializeToString(), out)


def calibrate(
    model: Path, frames: FrameSet, out: Path, dataset: Mapping[str, Any] | None = None
) -> tuple[Calibration, Counts]:
    """Fits the calibration on `frames` of homes that the weights were not trained on; writes the calibrated model."""
    counts = observe(model, frames)
    calibration = fit(counts)
    apply(model, calibration, len(frames), out, dataset)
    return calibration, counts


def table(counts: Counts, calibration: Calibration) -> str:
    """Text table by tenths of the uncalibrated confidence: mean confidence before and after, the share that agrees
    with labels, and the share of the cells."""
    before = -np.expm1(-LN_TOLERANCE * np.exp(-counts.log_scale))
    after = -np.expm1(-LN_TOLERANCE * np.exp(-(calibration.slope * counts.log_scale + calibration.offset)))
    weight = counts.right + counts.wrong
    lines = [f"ln b becomes {calibration.slope:.3f} ln b {calibration.offset:+.3f}", "before after  right  share"]
    for tenth in range(10):
        chosen = ((before * 10).astype(int).clip(0, 9) == tenth) & (weight > 0)
        if chosen.any():
            total = weight[chosen].sum()
            means = [(values[chosen] * weight[chosen]).sum() / total for values in (before, after)]
            right = counts.right[chosen].sum() / total
            lines.append(f"{means[0]:.3f}  {means[1]:.3f}  {right:.3f}  {total / weight.sum():.3f}")
    return "\n".join(lines)
