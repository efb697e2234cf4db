"""Depth metrics of the field, per image, beside simple baselines.

Ground truth counts from 0.1 to 20 m. `scaled`: after multiplying each image's depth by median(truth) / median(depth),
as is usual for networks without scale. The robot uses unscaled depth.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from embodied_depth_trainer.data.batches import FULL_CONFIDENCE, rgb_planes, to_depth
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.inputs import given_depth_of, second_input
from embodied_depth_trainer.networks.registry import output_of
from embodied_depth_trainer.studies.baselines import fill_nearest

MIN_TRUTH_M = 0.1
MAX_TRUTH_M = 20.0
BATCH = 8
# Confidence from which on the robot's map uses depth (`map.min_confidence`), and the suffix of the rows of such pixels.
MAPPED_CONFIDENCE = 0.8
CONFIDENT = ", mapped"
# Suffix of a network's rows on the pixels that have coarse depth.
REFINED = ", where coarse is"
# Suffix of the rows of a network that is given dense depth, joined with it as the robot does.
JOINED = ", joined with dense"
# Ratio up to which two depths agree.
AGREEING = 1.25
# The row of coarse depth whose holes have the depth of the nearest pixel.
FILLED = "coarse, holes filled"
# Bins of the probability that depth is correct.
BINS = 10


@dataclass(frozen=True)
class Metrics:
    """Metrics of one image, or their mean over images."""

    share: float
    """Share of the pixels with ground truth that have a depth."""
    right: float
    """Share of the pixels with ground truth whose unscaled depth is within 25 % of it; a missing depth counts as
    wrong."""
    delta1: float
    delta2: float
    delta3: float
    abs_rel: float
    rmse_m: float
    delta1_unscaled: float
    delta2_unscaled: float
    delta3_unscaled: float
    abs_rel_unscaled: float
    rmse_m_unscaled: float
    reliability: tuple[tuple[float, float, float], ...] = ()
    """For each tenth of the probability that depth is correct: mean probability, share that is correct, share of the
    pixels. Over all images; empty for networks that predict no probability."""

    @property
    def calibration_error(self) -> float | None:
        """Mean distance between the predicted probability and the share that is correct."""
        if not self.reliability:
            return None
        return sum(share * abs(predicted - right) for predicted, right, share in self.reliability)


def metrics(depth_m: NDArray[np.float32], truth_m: NDArray[np.float32]) -> Metrics | None:
    """The metrics of one image [H, W], where 0 is no depth. `None` if there is nothing to compare."""
    counts = (truth_m >= MIN_TRUTH_M) & (truth_m <= MAX_TRUTH_M)
    both = counts & (depth_m > 0)
    if not both.any():
        return None
    depth = depth_m[both].astype(np.float64)
    truth = truth_m[both].astype(np.float64)
    scaled = _errors(depth * (np.median(truth) / np.median(depth)), truth)
    plain = _errors(depth, truth)
    share = float(both.sum() / counts.sum())
    return Metrics(share, share * plain[0], *scaled, *plain)


def _errors(depth: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float, float, float, float]:
    ratio = np.maximum(depth / truth, truth / depth)
    deltas = [float((ratio < 1.25**power).mean()) for power in (1, 2, 3)]
    error = depth - truth
    return deltas[0], deltas[1], deltas[2], float((np.abs(error) / truth).mean()), float(np.sqrt((error**2).mean()))


def evaluate(frames: Frames, networks: dict[str, nn.Module], depth_range_m: tuple[float, float]) -> dict[str, Metrics]:
    """Mean metrics of the constant (each image's median of the truth), of coarse depth as it is and with its holes
    filled, of dense depth, and of every network: on all pixels, on those whose confidence suffices for the map, on
    those that have coarse depth, and joined with dense depth if it was given that."""
    if frames.truth_mm is None:
        raise TrainerError(
            "the frames have no ground truth; record with `firmware-host explore --depth truth`, "
            "or dump a dataset with depth.txt"
        )
    rows: dict[str, list[Metrics]] = {"constant": [], "coarse": []}
    reliabilities: dict[str, _Reliability] = {}
    images = 0
    for index, truth in _truths(frames):
        images += len(index)
        counts = (truth >= MIN_TRUTH_M) & (truth <= MAX_TRUTH_M)
        constant = [np.full_like(t, np.median(t[c]) if c.any() else 0) for t, c in zip(truth, counts, strict=True)]
        depths = {"constant": np.stack(constant)}
        if frames.coarse is not None:
            depths["coarse"] = frames.coarse[index, 0].astype(np.float32) / 1000
            depths[FILLED] = np.stack([fill_nearest(depth) for depth in depths["coarse"]])
            predicted = frames.coarse[index, 1].astype(np.float32) / FULL_CONFIDENCE
            reliabilities.setdefault("coarse", _Reliability()).add(depths["coarse"], predicted, truth)
        if frames.dense is not None:
            depths["dense"] = frames.dense[index, 0].astype(np.float32) / 1000
            dense_confidence = frames.dense[index, 1].astype(np.float32) / FULL_CONFIDENCE
            reliabilities.setdefault("dense", _Reliability()).add(depths["dense"], dense_confidence, truth)
        for name, network in networks.items():
            depth, confidence = predict(network, frames, index, depth_range_m)
            depths[name] = depth
            if confidence is not None:
                depths[name + CONFIDENT] = np.where(confidence >= MAPPED_CONFIDENCE, depth, 0)
                reliabilities.setdefault(name, _Reliability()).add(depth, confidence, truth)
                if "dense" in depths and given_depth_of(network) == "dense":
                    joint, sure = joined((depth, confidence), (depths["dense"], dense_confidence))
                    depths[name + JOINED] = joint
                    reliabilities.setdefault(name + JOINED, _Reliability()).add(joint, sure, truth)
            if "coarse" in depths:
                depths[name + REFINED] = np.where(depths["coarse"] > 0, depth, 0)
        for name, batch in depths.items():
            found = [metrics(depth, t) for depth, t in zip(batch, truth, strict=True)]
            rows.setdefault(name, []).extend(value for value in found if value is not None)
    means = {name: _mean(values, images) for name, values in rows.items() if values}
    return {
        name: replace(mean, reliability=reliabilities[name].bins()) if name in reliabilities else mean
        for name, mean in means.items()
    }


Estimate = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Depth in metres, 0 where there is none, and the probability that it is right."""


def joined(own: Estimate, other: Estimate) -> Estimate:
    """Two estimates of the same images as the robot joins them (`DepthEstimate::join` in the runtime): the more
    probable depth stays. Where both agree, it has the mean of their probabilities, elsewhere a lower one."""
    (depth, confidence), (other_depth, other_confidence) = own, other
    better = np.maximum(confidence, other_confidence)
    worse = np.minimum(confidence, other_confidence)
    agree = np.maximum(depth, other_depth) < AGREEING * np.minimum(depth, other_depth)
    alone = better * (1 - worse) / np.maximum(1 - better * worse, np.finfo(np.float32).eps)
    missing = other_depth <= 0
    joint = np.where(~missing & (other_confidence > confidence), other_depth, depth)
    return joint, np.where(missing, confidence, np.where(agree, (better + worse) / 2, alone)).astype(np.float32)


class _Reliability:
    """Sums over the pixels of each bin of the probability: probabilities, correct pixels, all pixels."""

    def __init__(self) -> None:
        self.sums = np.zeros((3, BINS))

    def add(self, depth_m: NDArray[np.float32], predicted: NDArray[np.float32], truth_m: NDArray[np.float32]) -> None:
        valid = (truth_m >= MIN_TRUTH_M) & (truth_m <= MAX_TRUTH_M) & (depth_m > 0)
        depth = depth_m[valid]
        truth = truth_m[valid]
        probability = predicted[valid].astype(np.float64)
        right = np.maximum(depth, truth) < 1.25 * np.minimum(depth, truth)
        place = (probability * BINS).astype(np.int64).clip(0, BINS - 1)
        for sums, values in zip(self.sums, (probability, right, np.ones(len(place))), strict=True):
            sums += np.bincount(place, values, BINS)

    def bins(self) -> tuple[tuple[float, float, float], ...]:
        predicted, right, count = self.sums[:, self.sums[2] > 0]
        shares = count / max(float(count.sum()), 1.0)
        return tuple(zip((predicted / count).tolist(), (right / count).tolist(), shares.tolist(), strict=True))


@torch.no_grad()
def predict(
    network: nn.Module, frames: Frames, index: NDArray[np.int64], depth_range_m: tuple[float, float]
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """The predicted z-depth [B, H, W] in metres, and the probability that it is correct within 25 % if the network
    predicts it."""
    network.eval()
    device = next(itertools.chain(network.parameters(), network.buffers())).device
    second = second_input(network, frames, index, depth_range_m, device)
    disparity, log_scale = output_of(network, rgb_planes(frames, index, device), second)
    depth: NDArray[np.float32] = to_depth(disparity, depth_range_m)[:, 0].cpu().numpy()
    if log_scale is None:
        return depth, None
    # The same formula as in the robot's runtime.
    confidence: NDArray[np.float32] = (1 - torch.exp(-math.log(1.25) / log_scale.exp()))[:, 0].cpu().numpy()
    return depth, confidence


def _truths(frames: Frames) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
    assert frames.truth_mm is not None
    with_truth = np.flatnonzero(frames.truth_mm.any(axis=(1, 2))).astype(np.int64)
    for start in range(0, len(with_truth), BATCH):
        index = with_truth[start : start + BATCH]
        truth: NDArray[np.float32] = frames.truth_mm[index].astype(np.float32) / np.float32(1000)
        yield index, truth


def _mean(values: list[Metrics], images: int) -> Metrics:
    keys = [key for key in asdict(values[0]) if key != "reliability"]
    mean = {key: float(np.mean([getattr(value, key) for value in values])) for key in keys}
    # An image without any depth lowers the share and the correct share, and no other metric.
    mean["share"] *= len(values) / images
    mean["right"] *= len(values) / images
    return Metrics(**mean)  # type: ignore[arg-type]


def table(rows: dict[str, Metrics]) -> str:
    """The metrics as a text table. The first is the share of all pixels that are right, which does not rise when a
    method leaves out what is difficult; delta1 of the pixels with depth stands beside it with their share."""
    head = (
        f"{'':36}right of all pixels  delta1 of share | delta2 delta3 abs_rel rmse_m "
        "| median-scaled: delta1 delta2 delta3 abs_rel rmse_m | calibration error"
    )
    lines = [head]
    for name, m in rows.items():
        plain = f"{m.delta2_unscaled:6.3f} {m.delta3_unscaled:6.3f} {m.abs_rel_unscaled:7.3f} {m.rmse_m_unscaled:6.3f}"
        scaled = f"{m.delta1:22.3f} {m.delta2:6.3f} {m.delta3:6.3f} {m.abs_rel:7.3f} {m.rmse_m:6.3f}"
        error = m.calibration_error
        calibration = "" if error is None else f" | {error:.3f}"
        first = f"{m.right:19.3f}  {m.delta1_unscaled:6.3f}    {m.share:5.2f}"
        lines.append(f"{name:36}{first} | {plain} | {scaled}{calibration}")
    return "\n".join(lines)
