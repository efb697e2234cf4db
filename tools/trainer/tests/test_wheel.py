"""The wheel holds what the program needs besides Python, and runs where it is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from embodied_depth_trainer import __version__

TRAINER = Path(__file__).resolve().parents[1]
DEFAULT = Path("firmware-host/models/default.onnx")
REPOSITORY = TRAINER.parents[1]
READ = """
from pathlib import Path
import embodied_depth_trainer, onnxruntime
file = Path(embodied_depth_trainer.__file__).with_name("default.onnx")
print(file, onnxruntime.InferenceSession(str(file)).get_modelmeta().custom_metadata_map["architecture"])
"""
INSTALL = ("install", "--no-deps", "--no-index", "--no-compile", "--quiet")


def call(*arguments: object, path: Path | None = None) -> str:
    """What a Python without this checkout prints."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=path or TRAINER)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def wheel(folder: Path) -> Path:
    """The wheel of a copy of the sources, because a build leaves files beside them."""
    copy = folder / "tools/trainer"
    left_out = shutil.ignore_patterns("__pycache__", "*.egg-info", "build", "tests", ".*")
    shutil.copytree(TRAINER, copy, symlinks=True, ignore=left_out)
    assert (copy / "src/embodied_depth_trainer/default.onnx").is_symlink()
    (folder / DEFAULT).parent.mkdir(parents=True)
    shutil.copyfile(REPOSITORY / DEFAULT, folder / DEFAULT)
    call("-m", "pip", "wheel", copy, "--no-deps", "--no-index", "--no-build-isolation", "--quiet", "-w", folder)
    (built,) = folder.glob("*.whl")
    return built


def test_the_wheel_has_the_default_network_and_the_command(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    built = wheel(tmp_path / "sources")
    with zipfile.ZipFile(built) as archive:
        names = set(archive.namelist())
    assert "embodied_depth_trainer/py.typed" in names
    modules = {str(file.relative_to(TRAINER / "src")) for file in (TRAINER / "src").rglob("*.py")}
    assert modules <= names
    # The link of the sources must not be what is installed.
    shutil.rmtree(tmp_path / "sources/firmware-host")
    installed = tmp_path / "installed"
    call("-m", "pip", *INSTALL, "--target", installed, built)
    network = installed / "embodied_depth_trainer/default.onnx"
    assert not network.is_symlink()
    assert network.read_bytes() == (REPOSITORY / DEFAULT).read_bytes()
    run = ("-m", "embodied_depth_trainer")
    assert call(*run, "--version", path=installed) == f"embodied-depth {__version__}\n"
    assert "\n    provenance " in call(*run, "--help", path=installed)
    assert f"embodied-depth {__version__}" in call(installed / "bin/embodied-depth", "--version", path=installed)
    assert call("-c", READ, path=installed) == f"{network} student\n"
