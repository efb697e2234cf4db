"""The student network: its initial prediction, its limits and its size."""

from __future__ import annotations

import math

import pytest
import torch

from embodied_depth_trainer.data.batches import to_depth
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.networks.student import DEFAULT_DEPTH_M, Student

RANGE_M = (0.1, 20.0)


def coarse_of(depth_m: float, confidence: float = 0.8) -> torch.Tensor:
    """Coarse input [1, 3, 32, 64] that is valid in the left half only."""
    planes = torch.zeros(1, 3, 32, 64)
    planes[:, 0, :, :32] = (1 / depth_m - 1 / 20) / (10 - 1 / 20)
    planes[:, 1, :, :32] = 1.0
    planes[:, 2, :, :32] = confidence
    return planes


def predicted_untrained(coarse: torch.Tensor) -> torch.Tensor:
    torch.manual_seed(0)
    network = Student(RANGE_M).eval()
    with torch.no_grad():
        size = (coarse.shape[2], coarse.shape[3])
        return to_depth(network(random_image(size, 0), coarse)[:, :1], RANGE_M)


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 2.5, 7.0])
def test_untrained_it_predicts_coarse_depth_and_fills_holes_from_their_surroundings(depth_m: float) -> None:
    assert torch.allclose(predicted_untrained(coarse_of(depth_m)), torch.tensor(depth_m), rtol=0.05)


def test_untrained_it_predicts_the_default_depth_without_coarse_depth() -> None:
    depth = predicted_untrained(torch.zeros(1, 3, 32, 64))
    assert torch.allclose(depth, torch.tensor(DEFAULT_DEPTH_M), rtol=0.05)


def test_a_hole_takes_the_depth_of_the_nearer_side() -> None:
    planes = coarse_of(1.0)
    planes[..., 48:] = coarse_of(4.0)[..., :16]
    depth = predicted_untrained(planes)[0, 0, 16]
    assert float(depth[34]) < 1.5
    assert float(depth[45]) > 2.5


def test_less_confident_depth_counts_less_in_a_hole() -> None:
    def middle(right: float) -> float:
        planes = coarse_of(1.0, 0.9)
        planes[..., 48:] = coarse_of(4.0, right)[..., :16]
        return float(predicted_untrained(planes)[0, 0, 16, 40])

    assert middle(0.5) < middle(0.9)


def test_the_output_stays_in_range_for_any_weights() -> None:
    torch.manual_seed(0)
    network = Student(RANGE_M).train()
    with torch.no_grad():
        network.head.weight.mul_(1e6)
        out = network(torch.rand(2, 3, 32, 64), torch.cat([coarse_of(0.1), coarse_of(20.0)]))
    assert out.shape == (2, 2, 32, 64)
    assert 0.0 <= float(out[:, 0].min()) <= float(out[:, 0].max()) <= 1.0
    assert math.log(0.0099) < float(out[:, 1].min()) <= float(out[:, 1].max()) < math.log(2.01)


def test_untrained_its_confidence_is_too_low_for_the_map() -> None:
    torch.manual_seed(0)
    with torch.no_grad():
        scale = Student(RANGE_M).eval()(random_image((32, 64), 0), coarse_of(2.0))[:, 1].exp()
    assert float((1 - torch.exp(-math.log(1.25) / scale)).max()) < 0.8


def test_in_inference_depth_in_holes_is_never_confident_enough_for_the_map() -> None:
    network = Student(RANGE_M)
    with torch.no_grad():
        assert network.head.bias is not None
        network.head.bias[3] = -20.0
        scale = network.eval()(random_image((32, 64), 0), coarse_of(2.0))[0, 1].exp()
    probability = 1 - torch.exp(-math.log(1.25) / scale)
    assert float(probability[:, 34:].max()) < 0.8
    assert float(probability[:, :30].min()) > 0.99


def test_every_weight_gets_a_gradient() -> None:
    torch.manual_seed(0)
    network = Student(RANGE_M).train()
    network(torch.rand(2, 3, 64, 64), torch.rand(2, 3, 64, 64)).sum().backward()
    assert all(weight.grad is not None and bool(weight.grad.any()) for weight in network.parameters())


def test_the_number_of_weights_is_small() -> None:
    assert 0.15e6 < sum(weight.numel() for weight in Student().parameters()) < 0.5e6
