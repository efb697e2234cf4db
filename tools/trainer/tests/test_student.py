"""The student: where it starts, what it may not do, and its size."""

from __future__ import annotations

import math

import pytest
import torch

from embodied_depth_trainer.batches import to_depth
from embodied_depth_trainer.onnx_file import random_picture
from embodied_depth_trainer.student import USUAL_DEPTH_M, Student

RANGE_M = (0.1, 20.0)


def coarse_of(depth_m: float, confidence: float = 0.8) -> torch.Tensor:
    """[1, 3, 32, 64]: valid in the left half only."""
    planes = torch.zeros(1, 3, 32, 64)
    planes[:, 0, :, :32] = (1 / depth_m - 1 / 20) / (10 - 1 / 20)
    planes[:, 1, :, :32], planes[:, 2, :, :32] = 1.0, confidence
    return planes


def said_by_an_untrained_one(coarse: torch.Tensor) -> torch.Tensor:
    torch.manual_seed(0)
    network = Student(RANGE_M).eval()
    with torch.no_grad():
        size = (coarse.shape[2], coarse.shape[3])
        return to_depth(network(random_picture(size, 0), coarse)[:, :1], RANGE_M)


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 2.5, 7.0])
def test_untrained_it_says_the_coarse_depth_and_fills_holes_from_around_them(depth_m: float) -> None:
    assert torch.allclose(said_by_an_untrained_one(coarse_of(depth_m)), torch.tensor(depth_m), rtol=0.05)


def test_untrained_it_says_the_usual_where_nothing_is_known() -> None:
    depth = said_by_an_untrained_one(torch.zeros(1, 3, 32, 64))
    assert torch.allclose(depth, torch.tensor(USUAL_DEPTH_M), rtol=0.05)


def test_a_hole_takes_the_depth_of_the_nearer_side() -> None:
    planes = coarse_of(1.0)
    planes[..., 48:] = coarse_of(4.0)[..., :16]
    depth = said_by_an_untrained_one(planes)[0, 0, 16]
    assert float(depth[34]) < 1.5
    assert float(depth[45]) > 2.5


def test_less_confident_depth_counts_less_in_a_hole() -> None:
    def middle(right: float) -> float:
        planes = coarse_of(1.0, 0.9)
        planes[..., 48:] = coarse_of(4.0, right)[..., :16]
        return float(said_by_an_untrained_one(planes)[0, 0, 16, 40])

    assert middle(0.5) < middle(0.9)


def test_it_stays_in_its_range_whatever_its_weights() -> None:
    torch.manual_seed(0)
    network = Student(RANGE_M).train()
    with torch.no_grad():
        network.head.weight.mul_(1e6)
        out = network(torch.rand(2, 3, 32, 64), torch.cat([coarse_of(0.1), coarse_of(20.0)]))
    assert out.shape == (2, 2, 32, 64)
    assert 0.0 <= float(out[:, 0].min()) <= float(out[:, 0].max()) <= 1.0
    assert math.log(0.0099) < float(out[:, 1].min()) <= float(out[:, 1].max()) < math.log(2.01)


def test_untrained_it_is_too_unsure_for_the_map() -> None:
    torch.manual_seed(0)
    with torch.no_grad():
        scale = Student(RANGE_M).eval()(random_picture((32, 64), 0), coarse_of(2.0))[:, 1].exp()
    assert float((1 - torch.exp(-math.log(1.25) / scale)).max()) < 0.8


def test_however_sure_of_a_hole_in_use_it_leaves_it_out_of_the_map() -> None:
    network = Student(RANGE_M)
    with torch.no_grad():
        assert network.head.bias is not None
        network.head.bias[3] = -20.0
        scale = network.eval()(random_picture((32, 64), 0), coarse_of(2.0))[0, 1].exp()
    probability = 1 - torch.exp(-math.log(1.25) / scale)
    assert float(probability[:, 34:].max()) < 0.8
    assert float(probability[:, :30].min()) > 0.99


def test_every_weight_learns() -> None:
    torch.manual_seed(0)
    network = Student(RANGE_M).train()
    network(torch.rand(2, 3, 64, 64), torch.rand(2, 3, 64, 64)).sum().backward()
    assert all(weight.grad is not None and bool(weight.grad.any()) for weight in network.parameters())


def test_it_is_small() -> None:
    assert 0.15e6 < sum(weight.numel() for weight in Student().parameters()) < 0.5e6
