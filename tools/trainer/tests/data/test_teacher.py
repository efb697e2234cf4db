"""Labels from a monocular network, which the test makes: it reads depth from the red of the image."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.data.alignment import align
from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.data.labels import CELL, labels
from embodied_depth_trainer.data.teacher import Teacher, teach
from embodied_depth_trainer.data.teacher_options import MEAN, STD, TeacherOptions
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.store import Store

from ..rooms import room
from ..stores import record

Shape = list[int | str]
ANY: Shape = [1, 3, "height", "width"]


def painted(frames: Frames) -> Frames:
    """Frames whose red is inverse depth: 255 at 0.5 m."""
    assert frames.truth_mm is not None
    rgb = frames.rgb.copy()
    rgb[..., 0] = (255 * 0.5 / (frames.truth_mm / 1000)).clip(0, 255).round()
    return replace(frames, rgb=rgb)


def write_teacher(file: Path, shape: Shape = ANY, depth: bool = False, patch: int = 14) -> Path:
    """A network that returns 3 red + 0.7 [N, rows, columns], or its reciprocal. It undoes the normalisation, and fails
    on sizes that are no multiples of its patch, as a vision transformer does."""
    last = shape[3] == 3
    rows, columns = (shape[1], shape[2]) if last else (shape[2], shape[3])
    constants: dict[str, NDArray[Any]] = {
        "zero": np.array(0, np.int64),
        "red": np.array(3 * STD[0], np.float32),
        "shift": np.array(3 * MEAN[0] + 0.7, np.float32),
    }
    nodes = [
        helper.make_node("Gather", ["image", "zero"], ["plane"], axis=3 if last else 1),
        helper.make_node("Mul", ["plane", "red"], ["scaled"]),
        helper.make_node("Add", ["scaled", "shift"], ["inverse"]),
    ]
    if patch > 1:
        # Into patches and back.
        constants["axis"] = np.array([1], np.int64)
        nodes += [
            helper.make_node("Unsqueeze", ["inverse", "axis"], ["one"]),
            helper.make_node("SpaceToDepth", ["one"], ["patches"], blocksize=patch),
            helper.make_node("DepthToSpace", ["patches"], ["whole"], blocksize=patch),
            helper.make_node("Squeeze", ["whole", "axis"], ["checked"]),
        ]
    else:
        nodes.append(helper.make_node("Identity", ["inverse"], ["checked"]))
    nodes.append(helper.make_node("Reciprocal" if depth else "Identity", ["checked"], ["predicted_depth"]))
    graph = helper.make_graph(
        nodes,
        "teacher",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("predicted_depth", TensorProto.FLOAT, [1, rows, columns])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), str(file))
    return file


def errors(planes: NDArray[np.uint16], frames: Frames) -> NDArray[np.float64]:
    """|ln label - ln truth| of each cell, NaN without a label."""
    assert frames.truth_mm is not None
    truth = frames.truth_mm[:, CELL // 2 :: CELL, CELL // 2 :: CELL].astype(np.float64)
    return np.abs(np.log(np.where(planes[:, 0] > 0, planes[:, 0], np.nan) / truth))


@pytest.fixture(scope="module")
def walk() -> Frames:
    return painted(room(12, (64, 192)))


@pytest.mark.parametrize(
    ("shape", "depth"),
    [(ANY, False), (ANY, True), ([1, 70, 196, 3], False), ([1, 3, 112, 224], False)],
    ids=["any size, inverse depth", "any size, depth", "colours last", "a size of its own"],
)
def test_a_teacher_fills_the_cells_without_a_label_with_aligned_depth(
    walk: Frames, tmp_path: Path, shape: Shape, depth: bool
) -> None:
    file = write_teacher(tmp_path / "teacher.onnx", shape, depth)
    own = labels(walk)
    teacher = Teacher(file, TeacherOptions("depth" if depth else "inverse"))
    planes = own.copy()
    taught = teach(walk, np.arange(len(walk)), planes, teacher)
    empty = own[:, 0] == 0
    assert empty.mean() > 0.05
    filled = empty & (planes[:, 0] > 0)
    assert filled.sum() > 0.95 * empty.sum()
    assert np.median(errors(planes, walk)[filled]) < 0.03
    # What motion has shown stays.
    assert np.array_equal(planes[:, :, ~empty.any(0)], own[:, :, ~empty.any(0)])
    assert taught.frames == len(walk)
    assert taught.agreeing > 0.9
    assert taught.after > taught.before


def test_images_become_multiples_of_the_patch(tmp_path: Path) -> None:
    teacher = Teacher(write_teacher(tmp_path / "teacher.onnx"), TeacherOptions())
    assert teacher.input_size(192, 640) == (196, 644)
    assert Teacher(teacher.file, TeacherOptions(multiple=32)).input_size(192, 640) == (192, 640)
    assert Teacher(teacher.file, TeacherOptions(size=(252, 518))).input_size(192, 640) == (252, 518)


def test_the_alignment_survives_wrong_depths_and_finds_scale_and_shift() -> None:
    random = np.random.default_rng(1)
    inverse = random.uniform(0.1, 2.0, 400)
    known_m = 1 / inverse * random.normal(1, 0.03, 400)
    known_m[:120] *= random.uniform(2, 5, 120)
    found = align((inverse - 0.05) / 0.4, known_m, np.ones(400))
    assert found is not None
    assert found.scale == pytest.approx(0.4, rel=0.03)
    assert found.shift == pytest.approx(0.05, abs=0.02)
    assert found.agreeing == pytest.approx(0.7, abs=0.05)


def test_a_teacher_that_contradicts_the_labels_is_not_used(walk: Frames, tmp_path: Path) -> None:
    teacher = Teacher(write_teacher(tmp_path / "teacher.onnx"), TeacherOptions())
    noise = np.random.default_rng(0).integers(0, 256, walk.rgb.shape, np.uint8)
    own = labels(walk)
    planes = own.copy()
    taught = teach(replace(walk, rgb=noise), np.arange(len(walk)), planes, teacher)
    assert taught.frames == 0
    assert np.array_equal(planes, own)
    assert align(np.ones(100), np.linspace(1, 2, 100), np.ones(100)) is None
    assert align(np.linspace(1, 2, 100), np.linspace(1, 2, 100), np.ones(100)) is None


def test_prepare_adds_the_teachers_labels(
    walk: Frames, tmp_path: Path, robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", walk, [len(walk)])
    command = ["prepare", str(tmp_path / "run"), "--firmware-host", str(robot), "--out"]
    teacher = ["--teacher", str(write_teacher(tmp_path / "teacher.onnx"))]
    assert main([*command, str(tmp_path / "store"), *teacher]) == 0
    assert main([*command, str(tmp_path / "without")]) == 0
    taught, own = (open_dataset([Store(tmp_path / name)]).frames.labels for name in ("store", "without"))
    assert taught is not None
    assert own is not None
    index = np.arange(len(walk))
    assert (taught[index][:, 0] > 0).mean() > 0.95 > (own[index][:, 0] > 0).mean()
    # A patch that the sizes do not fit, and a file that is no such network.
    fixed = write_teacher(tmp_path / "patch.onnx", patch=16)
    assert main([*command, str(tmp_path / "other"), "--teacher", str(fixed)]) == 1
    assert "give --teacher-size or --teacher-multiple" in capsys.readouterr().err
    assert main([*command, str(tmp_path / "third"), "--teacher", str(tmp_path / "nowhere.onnx")]) == 1
    assert "nowhere.onnx does not exist" in capsys.readouterr().err
    small = Teacher(write_teacher(tmp_path / "small.onnx", [1, 3, 28, 56]), TeacherOptions(size=(42, 56)))
    with pytest.raises(TrainerError, match="images only; omit --teacher-size"):
        small.input_size(64, 192)
