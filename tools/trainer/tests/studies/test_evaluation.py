"""The metrics against their definitions; the runtime's `accuracy` has the same tests."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.depth import DepthExport, export_depth
from embodied_depth_trainer.networks.registry import build_network
from embodied_depth_trainer.networks.runtime import OnnxNetwork
from embodied_depth_trainer.studies.baselines import fill_nearest
from embodied_depth_trainer.studies.evaluation import evaluate, joined, metrics, table
from embodied_depth_trainer.training.initial import SHIPPED

from ..recordings import dump_of, straight, write_segment
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


def test_estimates_are_joined_as_the_robot_joins_them() -> None:
    # The cases of the runtime's `estimate.rs`: agreement twice, disagreement twice, missing depth three times.
    own = row(2.0, 2.2, 2.0, 3.0, 2.0, 0.0, 0.0), row(0.75, 0.25, 0.5, 0.8, 0.6, 0.0, 0.0)
    other = row(2.2, 2.0, 3.0, 2.0, 0.0, 3.0, 0.0), row(0.25, 0.75, 0.8, 0.5, 0.0, 0.9, 0.0)
    depth, confidence = joined(own, other)
    assert depth[0].tolist() == pytest.approx([2.0, 2.0, 3.0, 3.0, 2.0, 3.0, 0.0])
    assert confidence[0].tolist() == pytest.approx([0.5, 0.5, 2 / 3, 2 / 3, 0.6, 0.9, 0.0])


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


def test_holes_take_the_depth_of_the_nearest_cell() -> None:
    depth = np.zeros((16, 32), np.float32)
    depth[:, :8] = 1.0
    depth[:, 24:] = 3.0
    filled = fill_nearest(depth)
    assert np.unique(filled).tolist() == [1.0, 3.0]
    assert np.unique(filled[:, :12]).tolist() == [1.0]
    assert np.unique(filled[:, 20:]).tolist() == [3.0]
    assert np.array_equal(filled[depth > 0], depth[depth > 0])
    assert not fill_nearest(np.zeros((16, 32), np.float32)).any()


@pytest.mark.parametrize("network", ["student", "manydepth_r18"])
def test_an_onnx_file_is_measured_like_the_checkpoint_that_it_was_exported_from(network: str, tmp_path: Path) -> None:
    frames = room(4, (32, 64))
    file = tmp_path / "model.onnx"
    export_depth(DepthExport(network, (32, 64), random=True, seed=5), file)
    original = build_network(network, (0.1, 20.0), 5)
    rows = evaluate(frames, {"original": original, "file": OnnxNetwork(file)}, (0.1, 20.0))
    assert rows["file"].right == pytest.approx(rows["original"].right, abs=1e-3)
    assert rows["file"].abs_rel == pytest.approx(rows["original"].abs_rel, abs=1e-4)
    # One of the four frames has no coarse depth to fill its holes with.
    assert rows["coarse, holes filled"].share == pytest.approx(0.75)


def test_evaluate_prints_an_onnx_file_beside_the_baselines_and_right_of_all_pixels_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, coarse, file = tmp_path / "run", tmp_path / "coarse", tmp_path / "model.onnx"
    run.mkdir()
    frames = room(6, (32, 64))
    write_segment(run / "recording_0000.mcap", frames, straight(6), truth=True)
    dump_of(frames, coarse)
    export_depth(DepthExport("student", (32, 64), random=True), file)
    command = ["evaluate", "--recording", str(run), "--coarse", str(coarse), "--model"]
    assert main([*command, str(file)]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.split("|")[0].strip() == "right of all pixels  delta1 of share"
    names = [line[:36].strip() for line in lines]
    assert names[:5] == ["constant", "coarse", "coarse, holes filled", "dense", "untrained"]
    assert "student" in names
    # A file without our metadata, and images of another size.
    model = onnx.load(str(file))
    del model.metadata_props[:]
    onnx.save(model, str(tmp_path / "foreign.onnx"))
    assert main([*command, str(tmp_path / "foreign.onnx")]) == 1
    assert "is no depth network of this trainer" in capsys.readouterr().err
    assert main([*command, str(SHIPPED)]) == 1
    assert "cannot become 192x640" in capsys.readouterr().err
