"""Cards say what the files say, and that they do not say the rest."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import onnx
import pytest
import yaml

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.export.depth import DepthExport, export_depth
from embodied_depth_trainer.sharing.cards import table
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.listing import freeze, segments_of
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import write_version
from embodied_depth_trainer.studies.evaluation import Metrics
from embodied_depth_trainer.training.initial import SHIPPED

from ..rooms import room
from ..stores import record, without_coarse

ROBOT = {"run": "5c" * 16, "boot": "3b3a", "robot": "ab" * 32, "name": "vacuum", "site": "kitchen of Anna"}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    record(tmp_path / "runs/monday", room(40), [24, 16], identity=ROBOT)
    record(tmp_path / "runs/tuesday", room(30, seed=1), [30])
    return without_coarse(tmp_path / "runs", tmp_path / "store")


def card(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[dict[str, Any], str]:
    """What a hub reads of the card, and the card."""
    capsys.readouterr()
    assert main(["card", *map(str, arguments)]) == 0
    text = capsys.readouterr().out
    _, front, _ = text.split("---\n", 2)
    return yaml.safe_load(front), text


def failed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert main(["card", *map(str, arguments)]) == 1
    return capsys.readouterr().err


def shipped_metadata() -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load(str(SHIPPED)).metadata_props}


def rows(text: str) -> dict[str, str]:
    """The rows with two columns of all tables."""
    cells = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return {row[0]: row[1] for row in cells if len(row) == 2}


def without_metadata(to: Path, *kept: str) -> Path:
    """The default network, whose file says less."""
    model = onnx.load(str(SHIPPED))
    said = {entry.key: entry.value for entry in model.metadata_props if entry.key in kept}
    onnx.helper.set_model_props(model, said)
    onnx.save(model, str(to))
    return to


def metrics(right: float, reliability: tuple[tuple[float, float, float], ...] = ()) -> dict[str, Any]:
    values = (1.0, right, 0.5, 0.5, 0.5, 0.1, 0.2, right, 0.5, 0.5, 0.25, 0.125)
    return asdict(Metrics(*values, reliability=reliability))


def test_a_card_says_what_the_file_says(capsys: pytest.CaptureFixture[str]) -> None:
    front, text = card(capsys, SHIPPED)
    assert front == {
        "library_name": "onnx",
        "pipeline_tag": "depth-estimation",
        "tags": ["onnx", "robotics", "depth-estimation", "embodied-depth"],
    }
    assert "| input | `coarse` | 1x3x192x640 | dense depth: x in 0..1 (below)," in text
    assert "| output | `disparity` | 1x2x192x640 | 1: depth along the optical axis as x in 0..1; 2: ln b," in text
    said = rows(text)
    metadata = shipped_metadata()
    dataset = json.loads(metadata["dataset"])
    assert said["depth range, m"] == f"{metadata['min_depth_m']} to {metadata['max_depth_m']}"
    assert said["intrinsics of these images, pixels"] == "fx = 320, fy = 320, cx = 319.5, cy = 95.5"
    assert said["began with"] == metadata["parent"]
    assert f"dataset {dataset['version']} ({dataset['frames']} frames" in said["data"]
    assert said["golden pair"] == "an input and the output for it are in the metadata"
    calibration = json.loads(metadata["calibration"])
    assert f"{calibration['frames']} frames of dataset {calibration['dataset']['version']}" in text
    assert '"learning_rate": 0.001' in text


def test_a_card_says_what_the_file_does_not_say(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = without_metadata(tmp_path / "silent.onnx", "kind")
    front, text = card(capsys, file)
    assert "license" not in front
    assert "base_model" not in front
    assert "datasets" not in front
    said = rows(text)
    for what in (
        "size of the images, rows x columns",
        "depth range, m",
        "intrinsics of these images, pixels",
        "architecture",
        "weights",
        "golden pair",
        "largest difference of ONNX Runtime from PyTorch at export",
    ):
        assert said[what] == "the file does not say"
    assert "The file does not say that a training made it." in text
    assert "The file does not say that its confidence was calibrated." in text
    assert "The file does not say how accurate it is, and no results were given." in text
    assert "No licence was given" in text
    # Not even the formula of depth, whose range is unknown.
    assert "near =" not in text


def test_a_training_whose_beginning_is_unknown_did_not_begin_with_random_weights(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = without_metadata(tmp_path / "older.onnx", "kind")
    model = onnx.load(str(file))
    model.metadata_props.add(key="training", value='{"steps": 7}')
    onnx.save(model, str(file))
    assert rows(card(capsys, file)[1])["began with"] == "the file does not say"
    model.metadata_props[-1].value = '{"steps": 7, "init": null}'
    onnx.save(model, str(file))
    said = rows(card(capsys, file)[1])
    assert (said["began with"], said["steps"]) == ("random weights", "7")
    assert said["data"] == "steps 1 to 7: the file does not say on which recordings"


def test_what_only_the_user_knows_is_an_option(capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--license", "cc-by-4.0", "--base-model", "workshop/first", "--trained-on", "workshop/kitchen")
    front, text = card(capsys, SHIPPED, *options)
    assert (front["license"], front["base_model"], front["datasets"]) == (
        "cc-by-4.0",
        "workshop/first",
        ["workshop/kitchen"],
    )
    assert "`cc-by-4.0`, as the person says who published this." in text


def test_measured_numbers_stand_beside_those_of_trivial_baselines(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    title = shipped_metadata()["version"]
    results = tmp_path / "results.json"
    found = {"constant": metrics(0.475), "coarse": metrics(0.5), title: metrics(0.864, ((0.9, 0.8, 1.0),))}
    results.write_text(json.dumps(found))
    _, text = card(capsys, SHIPPED, "--results", results)
    assert "Measured on: the results do not say which recordings." in text
    network = f"| **this network** ({title}) | 0.864 | 1.000 | 0.864 | 0.250 | 0.125 | 0.100 |"
    assert network in text
    assert "| baseline: each image's median of the truth | 0.475 | 1.000 | 0.475 | 0.250 | 0.125 |  |" in text
    # Test views have several parts.
    results.write_text(json.dumps({"all": found, "after a rotation": found}))
    _, text = card(capsys, SHIPPED, "--results", results, "--measured-on", "13 sequences")
    assert "Measured on: 13 sequences." in text
    assert text.count(network) == 2
    assert "### after a rotation" in text


def test_numbers_of_another_network_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    results = tmp_path / "results.json"
    results.write_text(json.dumps({"constant": metrics(0.475), "student-600": metrics(0.9)}))
    said = failed(capsys, SHIPPED, "--results", results)
    shipped = shipped_metadata()["version"]
    assert f"{results} has numbers of constant, student-600 and none of {shipped}" in said
    results.write_text('{"accuracy": 1}')
    assert f"{results} has no results" in failed(capsys, SHIPPED, "--results", results)


def test_a_card_replaces_no_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "README.md"
    assert main(["card", str(SHIPPED), "--out", str(out)]) == 0
    capsys.readouterr()
    assert main(["card", str(SHIPPED)]) == 0
    assert out.read_text() == capsys.readouterr().out
    out.write_text("mine")
    assert f"{out} exists and is not replaced" in failed(capsys, SHIPPED, "--out", out)
    assert out.read_text() == "mine"


def test_a_file_of_another_program_has_no_card(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "does not say of which kind it is" in failed(capsys, without_metadata(tmp_path / "other.onnx"))
    (tmp_path / "damaged.onnx").write_bytes(b"no network")
    assert "is not an ONNX file" in failed(capsys, tmp_path / "damaged.onnx")
    assert "is no store" in failed(capsys, tmp_path)
    assert "is no list of shards" in failed(capsys, tmp_path / "missing")


def test_the_card_of_a_store_counts_what_is_in_it(capsys: pytest.CaptureFixture[str], store: Store) -> None:
    front, text = card(capsys, store.folder)
    version = open_dataset([store]).version
    assert front == {
        "pretty_name": f"Embodied Depth {version.name}",
        "task_categories": ["depth-estimation", "robotics"],
        "size_categories": ["n<1K"],
        "tags": ["embodied-depth"],
    }
    said = rows(text)
    assert said["robots"] == f"vacuum (public key {'ab' * 8}...); 1 segments do not say which robot"
    assert (said["runs"], said["segments"], said["frames"]) == ("2", "3", "70")
    dataset = open_dataset([store])
    held_out = dataset.frames.held_out
    assert held_out is not None
    assert said["frames of held-out places"].startswith(f"{100 * held_out.mean():.1f} %")
    times = [part.frames.time_ns for part in dataset.parts]
    minutes = sum(int(time[-1] - time[0]) for time in times) / 60e9
    assert said["minutes"].startswith(f"{minutes:.2f},")
    assert (said["coarse depth"], said["labels"], said["program that computed it"]) == ("none", "none", "none")
    assert said["policies"] == "the file does not say"
    camera = dataset.frames.camera
    assert f"| {camera.height}x{camera.width} | {camera.fx:.6g} |" in text
    assert "those that the robot's own localization had" in text
    assert f"--expect {version.name}" in text
    assert "Anna" not in text


def test_images_that_no_simulation_made_are_said_to_be_private(
    capsys: pytest.CaptureFixture[str], store: Store
) -> None:
    _, text = card(capsys, store.folder)
    assert "**Images may show a real home.** 3 of 3 segments name no simulated world" in text
    simulate(store, 1)
    _, text = card(capsys, store.folder)
    assert "**Images may show a real home.** 2 of 3 segments name no simulated world" in text
    simulate(store, 3)
    _, text = card(capsys, store.folder)
    assert "All images are simulated, as the recordings say. None shows a real place." in text
    assert "real home" not in text
    assert rows(text)["simulated worlds"] == "builtin:house?seed=3"


def simulate(store: Store, count: int) -> None:
    """Lets the first shards say that they are of a simulation."""
    for segment in segments_of(store)[:count]:
        file = store.shard(segment.shard) / "meta.json"
        meta = json.loads(file.read_text())
        meta["recorded"]["scene"] = "builtin:house?seed=3"
        file.write_text(json.dumps(meta))


def test_the_card_of_a_list_is_of_its_shards_only(
    capsys: pytest.CaptureFixture[str], store: Store, tmp_path: Path
) -> None:
    listed = tmp_path / "tuesday.json"
    version = freeze(store, [segment.shard for segment in segments_of(store) if segment.folder.endswith("tuesday")])
    write_version(version, listed)
    assert f"{listed} is a list of shards; give the store" in failed(capsys, listed)
    _, text = card(capsys, listed, "--store", store.folder)
    said = rows(text)
    assert (said["runs"], said["segments"], said["frames"]) == ("1", "1", "30")
    assert f"# Dataset {version.name}\n" in text
    assert "vacuum" not in text


def test_numbers_of_a_network_are_not_left_out_of_the_card_of_a_dataset(
    capsys: pytest.CaptureFixture[str], store: Store
) -> None:
    assert f"{store.folder} is a dataset; --results" in failed(capsys, store.folder, "--results", "results.json")


def test_a_flow_network_predicts_no_depth(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = without_metadata(tmp_path / "flow.onnx", "input_width", "input_height")
    model = onnx.load(str(file))
    model.metadata_props.add(key="kind", value="flow")
    model.graph.output[0].name = "flow"
    onnx.save(model, str(file))
    front, text = card(capsys, file)
    assert "pipeline_tag" not in front
    assert "optical-flow" in front["tags"]
    assert "motion from the first to the second image in pixels" in text
    assert "## Calibration" not in text
    assert "depth range" not in text


def test_a_network_with_a_cost_volume_names_its_planes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "manydepth.onnx"
    export_depth(DepthExport("manydepth_r18", (32, 64), random=True), file)
    _, text = card(capsys, file)
    assert "| input | `volume` | 1x96x8x16 | matching cost of planes from 20.0 m to 0.3 m:" in text
    assert "| output | `disparity` | 1x1x32x64 | depth along the optical axis as x in 0..1 |" in text
    assert rows(text)["weights"] == "random"


def test_a_value_does_not_break_a_table() -> None:
    assert table(["a", "b"], [["1 | 2", "3\n4"]]).splitlines()[2] == "| 1 \\| 2 | 3 4 |"
