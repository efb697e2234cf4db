"""A training goes on from a checkpoint or from an exported ONNX file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import labels
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.export.depth import DepthExport, export_depth
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.networks.exported import load_exported, module_name, read_metadata, restore_statistics
from embodied_depth_trainer.networks.registry import build_network
from embodied_depth_trainer.networks.student import Student
from embodied_depth_trainer.training.initial import SHIPPED, initial_network
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer, train

from ..rooms import room

RANGE_M = (0.1, 20.0)
# Of x in 0..1 and ln b: the same sums in another order.
TOLERANCE = 1e-4
QUICK = Settings(batch=2, learning_rate=1e-3)


@pytest.fixture(scope="module")
def walk() -> Frames:
    frames = room(24)
    return replace(frames, labels=labels(frames))


def inputs(size: tuple[int, int], seed: int) -> list[torch.Tensor]:
    """A random image and coarse depth with holes."""
    coarse = random_image(size, seed + 1)
    coarse[:, 1] = (coarse[:, 1] > 0.5).float()
    coarse = coarse * coarse[:, 1:2]
    return [random_image(size, seed), coarse]


def trainer(frames: Frames, settings: Settings) -> Trainer:
    return Trainer(frames, pairs_by_baseline(frames, PairRule()), settings)


def test_the_loaded_default_network_computes_what_its_file_computes_before_its_calibration() -> None:
    network = initial_network("student", RANGE_M, 0, str(SHIPPED))
    calibration = json.loads(read_metadata(SHIPPED)[1]["calibration"])
    session = onnxruntime.InferenceSession(str(SHIPPED), providers=["CPUExecutionProvider"])
    for seed in range(3):
        rgb, coarse = inputs((192, 640), seed)
        found = session.run(None, {"rgb": rgb.numpy(), "coarse": coarse.numpy()})[0]
        with torch.no_grad():
            expected = network(rgb, coarse).numpy()
        expected[:, 1] = calibration["slope"] * expected[:, 1] + calibration["offset"]
        # Measured: 6e-7 of x, 2.4e-6 of ln b.
        assert np.abs(expected - found).max() < 1e-5


def test_an_exported_resnet_can_be_loaded(tmp_path: Path) -> None:
    file = tmp_path / "model.onnx"
    export_depth(DepthExport("monodepth2_r18", (32, 64), random=True, seed=3), file)
    image, _ = inputs((32, 64), 5)
    original = build_network("monodepth2_r18", RANGE_M, 3).eval()
    loaded = initial_network("monodepth2_r18", RANGE_M, 8, str(file))
    with torch.no_grad():
        assert torch.allclose(loaded(image), original(image), atol=TOLERANCE)


def test_measured_statistics_change_nothing_in_evaluation_and_make_training_begin_at_the_same_depth() -> None:
    network = initial_network("student", RANGE_M, 0, str(SHIPPED))
    rgb, coarse = (torch.cat(planes) for planes in zip(*(inputs((64, 192), seed) for seed in range(8)), strict=True))
    with torch.no_grad():
        before = network(rgb, coarse)
        blind = network.train()(rgb, coarse)[:, :1]
    network = initial_network("student", RANGE_M, 0, str(SHIPPED))
    restore_statistics(network, [(rgb, coarse)])
    with torch.no_grad():
        assert torch.allclose(network.eval()(rgb, coarse), before, atol=TOLERANCE)
        trained = network.train()(rgb, coarse)[:, :1]
    assert float((trained - before[:, :1]).abs().max()) < TOLERANCE
    # Without them, the first step would begin elsewhere.
    assert float((blind - before[:, :1]).abs().mean()) > 10 * TOLERANCE


def test_names_of_exported_nodes_become_names_of_modules() -> None:
    assert module_name("/stem/stem.0/Conv") == "stem.0"
    assert module_name("/down.0/down.0.1/block/block.0/Conv") == "down.0.1.block.0"
    assert module_name("/head/Conv") == "head"


def test_a_training_goes_on_from_a_checkpoint_and_from_the_default_network(walk: Frames, tmp_path: Path) -> None:
    file = train(trainer(walk, QUICK), 3, tmp_path / "first")
    learner = trainer(walk, replace(QUICK, init=str(file)))
    assert learner.step == 0
    first = torch.load(file, weights_only=True)["weights"]
    assert all(torch.equal(value, first[name]) for name, value in learner.checkpoint().weights.items())
    settings = replace(QUICK, init=str(SHIPPED))
    saved = train(trainer(walk, settings), 2, tmp_path / "shipped")
    assert train(trainer(walk, settings), 3, tmp_path / "shipped") == saved
    # Another beginning needs another place.
    with pytest.raises(TrainerError, match=r"init.*default\.onnx sha256:.*another --out"):
        train(trainer(walk, QUICK), 4, tmp_path / "shipped")


def test_files_that_do_not_fit_the_training_are_refused(walk: Frames, tmp_path: Path) -> None:
    def refused(words: str, settings: Settings) -> None:
        with pytest.raises(TrainerError, match=words):
            trainer(walk, settings)

    student = train(trainer(walk, QUICK), 1, tmp_path)
    refused("architecture = student, the training edn_r18", replace(QUICK, network="edn_r18", init=str(SHIPPED)))
    refused("holds `student`", replace(QUICK, network="edn_r18", init=str(student)))
    refused("max_depth_m = 20.0, the training 10.0", replace(QUICK, depth_range_m=(0.1, 10.0), init=str(SHIPPED)))
    refused("give one of the two", replace(QUICK, network="edn_r18", init=str(student), encoder="imagenet"))
    refused("nowhere.onnx does not exist", replace(QUICK, init="nowhere.onnx"))
    (tmp_path / "text.onnx").write_text("no model")
    refused("is not an ONNX file", replace(QUICK, init=str(tmp_path / "text.onnx")))


def test_a_file_of_another_version_of_the_network_is_refused(tmp_path: Path) -> None:
    model = onnx.load(str(SHIPPED))
    (head,) = (value for value in model.graph.initializer if value.name == "head.bias")
    head.CopyFrom(onnx.numpy_helper.from_array(onnx.numpy_helper.to_array(head) + 1, "head.bias"))
    onnx.save(model, str(tmp_path / "other.onnx"))
    network: nn.Module = Student(RANGE_M)
    with pytest.raises(TrainerError, match="differs from the file's golden output"):
        load_exported(network, "student", RANGE_M, tmp_path / "other.onnx")


def test_bfloat16_trains_a_student_from_the_default_network_close_to_single_precision(walk: Frames) -> None:
    exact, rough = (trainer(walk, replace(QUICK, init=str(SHIPPED), amp=amp)) for amp in (False, True))
    losses = [learner.advance()[0] for learner in (exact, rough)]
    assert losses[1] == pytest.approx(losses[0], rel=0.02)
    # The same image's depth differs by less than 2 %.
    batch = exact.batch(5)
    for learner in (exact, rough):
        learner.network.eval()
    with torch.no_grad():
        depths = [1 / (0.05 + 9.95 * learner.predict(batch.image, batch.coarse)[0]) for learner in (exact, rough)]
    assert float((depths[1] / depths[0]).log().abs().mean()) < 0.02


def test_a_gpu_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["train", "--store", str(tmp_path), "--steps", "1", "--out", str(tmp_path), "--device", "cuda"]
    assert main(command) == 1
    assert "--device cpu" in capsys.readouterr().err
