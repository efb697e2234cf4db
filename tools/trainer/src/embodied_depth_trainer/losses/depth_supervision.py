"""Losses that compare depth with coarse depth or labels, and those that train the predicted scale of the error."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from embodied_depth_trainer import processes
from embodied_depth_trainer.data.batches import to_depth

# Depth within 25 % of the truth is correct, as for the metric delta1.
LN_TOLERANCE = math.log(1.25)


def coarse_error(depth_m: Tensor, coarse: Tensor, depth_range_m: tuple[float, float]) -> Tensor:
    """Mean |ln depth - ln coarse depth|, weighted by the coarse depth's confidence, also where coarse depth was
    dropped from the network's input: several keyframes and an epipolar search know more than the colours of two
    neighbours. Scalar."""
    weight = coarse[:, 1:2] * coarse[:, 2:3]
    error = (depth_m.log() - to_depth(coarse[:, :1], depth_range_m).log()).abs()
    return (weight * error).sum() / processes.mean(weight.sum()).clamp(min=1.0)


def label_error(depth_m: Tensor, labels: Tensor) -> Tensor:
    """Mean |ln depth - ln label| at the middle of each labelled cell, weighted by the label's confidence. Scalar."""
    label_m = labels[:, :1]
    confidence = labels[:, 1:]
    error = (at_cell_centres(depth_m, labels).log() - label_m.clamp(min=1e-3).log()).abs()
    return (confidence * error).sum() / processes.mean(confidence.sum()).clamp(min=1.0)


def correctness_nll(depth_m: Tensor, log_scale: Tensor, labels: Tensor) -> Tensor:
    """Mean negative log-likelihood of the event that depth is within 25 % of the label, which is what the robot
    derives from the predicted scale. Weighted by the label's confidence. Scalar."""
    label_m = labels[:, :1]
    confidence = labels[:, 1:]
    error = (at_cell_centres(depth_m, labels).log() - label_m.clamp(min=1e-3).log()).abs()
    # ln P(wrong) of a Laplacian: e^(-ln 1.25 / b).
    log_wrong = -LN_TOLERANCE * torch.exp(-at_cell_centres(log_scale, labels))
    log_right = torch.log(-torch.expm1(log_wrong.clamp(max=-1e-6)))
    nll = -torch.where(error < LN_TOLERANCE, log_right, log_wrong)
    return (confidence * nll).sum() / processes.mean(confidence.sum()).clamp(min=1.0)


def at_cell_centres(plane: Tensor, labels: Tensor) -> Tensor:
    """Samples `plane` [B, 1, H, W] at the pixels that the labels [B, 2, h, w] belong to."""
    cell = plane.shape[2] // labels.shape[2]
    return plane[..., cell // 2 :: cell, cell // 2 :: cell]


def laplace_nll(depth_m: Tensor, log_scale: Tensor, coarse: Tensor, depth_range_m: tuple[float, float]) -> Tensor:
    """Mean negative log-likelihood of Laplacian errors of ln depth with the predicted scales. Scalar.

    The error is not measured, but coarse depth bounds it, also where it was dropped from the network's input: |error|
    is at most the distance to the coarse depth plus the coarse depth's own error, whose scale follows from its
    probability of being correct within 25 %.
    """
    valid = coarse[:, 1:2]
    confidence = coarse[:, 2:3].clamp(0.01, 0.999)
    distance = (depth_m.log() - to_depth(coarse[:, :1], depth_range_m).log()).abs()
    error = distance - LN_TOLERANCE / torch.log1p(-confidence)
    return (valid * (error * torch.exp(-log_scale) + log_scale)).sum() / processes.mean(valid.sum()).clamp(min=1.0)
