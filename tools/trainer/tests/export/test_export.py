"""Exported models: their metadata, and the parity of ONNX Runtime with PyTorch."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.export.depth import DEPTH_NETWORKS, DepthExport, build
from embodied_depth_trainer.networks.edn import Edn
from embodied_depth_trainer.networks.golden import at_block_centres, golden_inputs, golden_output
from embodied_depth_trainer.networks.monodepth2 import Monodepth2
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..rooms import room


def metadata(file: Path) -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load(str(file)).metadata_props}


@pytest.mark.parametrize("network", DEPTH_NETWORKS)
def test_a_depth_model_has_the_metadata_that_the_robot_needs(network: str, tmp_path: Path) -> None:
    out = tmp_path / "depth.onnx"
    size = ["--size", "32x64", "--depth-range", "0.3", "10"]
    assert main(["export-depth", "--network", network, "--random", *size, "--out", str(out)]) == 0
    model = onnx.load(str(out))
    names = [value.name for value in model.graph.input]
    info = metadata(out)
    kinds = {"monodepth2_r18": "rgb", "sc_depth_r18": "rgb", "manydepth_r18": "rgb+volume"}
    assert info["kind"] == "+".join(names) == kinds.get(network, "rgb+coarse")
    assert (info["output"], info["min_depth_m"], info["max_depth_m"]) == ("disparity", "0.3", "10.0")
    assert (info["input_width"], info["input_height"], info["opset"]) == ("64", "32", "17")
    assert info["weights"] == "random"
    assert float(info["parity_max_abs"]) < 1e-4
    assert [path.name for path in tmp_path.iterdir()] == ["depth.onnx"]


def test_a_trained_student_is_exported_with_a_valid_golden_pair(tmp_path: Path) -> None:
    frames = room(24)
    learner = Trainer(frames, pairs_by_baseline(frames, PairRule()), Settings(batch=2))
    file = train(learner, 3, tmp_path)
    out = tmp_path / "student.onnx"
    assert main(["export", "--checkpoint", str(file), "--out", str(out)]) == 0
    info = metadata(out)
    assert (info["kind"], info["output"], info["version"], info["opset"]) == (
        "rgb+coarse",
        "disparity",
        "student-3",
        "17",
    )
    assert (info["min_depth_m"], info["max_depth_m"]) == ("0.1", "20.0")
    assert (info["input_width"], info["input_height"]) == ("96", "32")
    assert json.loads(info["intrinsics"])["fx"] == 48.0
    assert json.loads(info["training"])["steps"] == 3
    size = (32, 96)
    inputs = golden_inputs(info, {"rgb": 3, "coarse": 3}, size)
    session = onnxruntime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    found = session.run(None, {name: value.numpy() for name, value in inputs.items()})[0]
    assert np.allclose(at_block_centres(found[0, 0]), golden_output(info, size), atol=1e-4)
    # A constant would prove nothing.
    assert golden_output(info, size).std() > 0.01
    operators = {node.op_type for node in onnx.load(str(out)).graph.node}
    assert not operators & {"GridSample", "Pad", "BatchNormalization"}


def test_an_export_of_another_size_has_scaled_intrinsics(tmp_path: Path) -> None:
    frames = room(24)
    file = train(Trainer(frames, pairs_by_baseline(frames, PairRule()), Settings(batch=2)), 1, tmp_path)
    out = tmp_path / "large.onnx"
    assert main(["export", "--checkpoint", str(file), "--size", "64x192", "--out", str(out)]) == 0
    assert json.loads(metadata(out)["intrinsics"]) == {"fx": 96.0, "fy": 96.0, "cx": 95.5, "cy": 31.5}


def test_a_flow_model_has_the_metadata_that_the_robot_needs(tmp_path: Path) -> None:
    out = tmp_path / "flow.onnx"
    arguments = ["--random", "--size", "128x136", "--iterations", "1", "--out", str(out)]
    assert main(["export-flow", "--network", "raft_small", *arguments]) == 0
    model = onnx.load(str(out))
    shapes = [
        [d.dim_value for d in value.type.tensor_type.shape.dim] for value in (*model.graph.input, *model.graph.output)
    ]
    assert shapes == [[1, 3, 128, 136], [1, 3, 128, 136], [1, 2, 128, 136]]
    info = metadata(out)
    assert (info["kind"], info["input_range"], info["weights"], info["iterations"]) == (
        "flow",
        "0..1",
        "random",
        "1",
    )


def test_weights_are_loaded_from_a_file(tmp_path: Path) -> None:
    torch.manual_seed(1)
    network = Monodepth2()
    file = tmp_path / "weights.pth"
    torch.save(network.state_dict(), file)
    loaded = build(DepthExport("monodepth2_r18", (32, 32), weights=file))
    image = torch.rand(1, 3, 32, 32)
    with torch.no_grad():
        assert torch.equal(loaded(image), network.eval()(image))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["export-depth", "--network", "edn_r18", "--random", "--size", "30x64"], "multiples of 32"),
        (["export-depth", "--network", "edn_r18"], "--weights FILE or --random"),
        (["export-depth", "--network", "edn_r18", "--random", "--depth-range", "5", "1"], "0 < MIN_M < MAX_M"),
        (["export-flow", "--network", "raft_small", "--random", "--size", "64x64"], "at least 128"),
        (["export-flow", "--network", "raft_small", "--weights", "/nowhere/raft.pth"], "does not exist"),
    ],
)
def test_impossible_requests_are_refused_with_advice(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.onnx"
    assert main([*arguments, "--out", str(out)]) == 1
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_addition_and_concatenation_have_the_papers_numbers_of_weights() -> None:
    def millions(network: torch.nn.Module) -> float:
        return sum(weight.numel() for weight in network.parameters()) / 1e6

    # The published numbers include ImageNet's last layer in every encoder, which no depth network uses.
    unused = 0.513
    assert millions(Monodepth2()) + unused == pytest.approx(14.84, abs=0.02)
    assert millions(Edn("add")) + 2 * unused == pytest.approx(26.5, abs=0.1)
    assert millions(Edn("concat")) + 2 * unused == pytest.approx(28.5, abs=0.1)


def test_coarse_depth_changes_the_depth() -> None:
    torch.manual_seed(0)
    network = Edn("add").eval()
    image = torch.rand(1, 3, 32, 32)
    with torch.no_grad():
        without = network(image, torch.zeros(1, 3, 32, 32))
        with_coarse = network(image, torch.ones(1, 3, 32, 32))
    assert without.shape == (1, 1, 32, 32)
    assert not torch.equal(without, with_coarse)
    assert 0.0 <= float(without.min()) <= float(without.max()) <= 1.0
