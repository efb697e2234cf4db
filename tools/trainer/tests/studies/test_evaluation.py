"""The metrics against their definitions; the runtime's `accuracy` has the same tests."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.studies.evaluation import evaluate, metrics, table

from ..rooms import room


def row(*values: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.array([values], np.float32)


def test_twice_the_depth_is_correct_only_after_scaling() -> None:
    found = metrics(row(2, 4, 6), row(1, 2, 3))
    assert found is not None
    assert (found.delta1, found.abs_rel, found.delta1_unscaled, found.delta3_unscaled) == (1.0, 0.0, 0.0, 0.0)
    assert found.abs_rel_unscaled == pytest.approx(1.0)
    assert found.rmse_m_unscaled == pytest.approx(np.sqrt(14 / 3))


def test_pixels_without_truth_outside_the_range_or_without_depth_do_not_count() -> None:
    found = metrics(row(1, 9, 9, 9, 0), row(1, 0, 0.05, 25, 2))
    assert found is not None
    assert (found.share, found.delta1_unscaled) == (0.5, 1.0)
    assert metrics(row(0, 1), row(1, 0)) is None


def test_no_depth_counts_as_wrong_among_all_pixels() -> None:
    found = metrics(row(2, 3, 0, 0), row(2, 2, 2, 2))
    assert found is not None
    assert (found.delta1_unscaled, found.right) == (0.5, 0.25)


class ConstantPrediction(nn.Module):
    """Predicts 2 m everywhere, correct with a probability of 60 %."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.tensor(math.log(-math.log(1.25) / math.log(0.4))))

    def forward(self, rgb: torch.Tensor, coarse: torch.Tensor) -> torch.Tensor:
        two_metres = torch.full_like(rgb[:, :1], (1 / 2 - 1 / 20) / (10 - 1 / 20))
        return torch.cat([two_metres, self.scale.expand_as(two_metres)], 1)


def test_the_calibration_error_is_the_distance_between_predicted_and_actual_correctness() -> None:
    frames = room(4)
    assert frames.truth_mm is not None
    frames.truth_mm[:] = 3000
    frames.truth_mm[..., :24] = 2000
    rows = evaluate(frames, {"network": ConstantPrediction()}, (0.1, 20.0))
    ((probability, right, share),) = rows["network"].reliability
    assert (probability, right, share) == pytest.approx((0.6, 0.25, 1.0), abs=1e-5)
    assert rows["network"].calibration_error == pytest.approx(0.35, abs=1e-5)
    assert rows["constant"].calibration_error is None
    assert rows["network, where coarse is"].share == pytest.approx(rows["coarse"].share)


def test_deltas_are_powers_of_a_quarter_more() -> None:
    found = metrics(row(1, 1.3, 1.6, 3), row(1, 1, 1, 1))
    assert found is not None
    assert (found.delta1_unscaled, found.delta2_unscaled, found.delta3_unscaled) == (0.25, 0.5, 0.75)


def test_the_constant_is_the_truths_median_and_coarse_depth_is_evaluated_where_valid() -> None:
    frames = room(12)
    rows = evaluate(frames, {}, (0.1, 20.0))
    assert rows["constant"].delta1 == pytest.approx(rows["constant"].delta1_unscaled, abs=0.01)
    assert rows["constant"].share == 1.0
    assert 0.4 < rows["coarse"].share < 0.7
    assert rows["coarse"].delta1_unscaled > 0.99
    assert "constant" in table(rows)
    with pytest.raises(TrainerError, match="--depth truth"):
        evaluate(replace(frames, truth_mm=None), {}, (0.1, 20.0))
