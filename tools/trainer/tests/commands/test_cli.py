"""The command line itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from embodied_depth_trainer.commands.cli import COMMANDS, parser

TRAINER = Path(__file__).resolve().parents[2]
SOURCES = "import sys; from embodied_depth_trainer.commands.cli import main, parser"


def without_torch(code: str) -> str:
    """Runs code in a new process. Returns what it prints, after it was checked that nothing has loaded PyTorch."""
    checked = f"{SOURCES}\ntry:\n    {code}\nfinally:\n    assert 'torch' not in sys.modules"
    environment = {**os.environ, "PYTHONPATH": str(TRAINER / "src")}
    done = subprocess.run([sys.executable, "-c", checked], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_help_needs_no_pytorch_and_names_every_command() -> None:
    said = without_torch("main(['--help'])")
    for name in COMMANDS:
        assert f"\n    {name} " in said


def test_exports_and_the_catalogue_need_no_pytorch() -> None:
    without_torch("parser('convert').parse_args(['convert', 'run', '--as', 'ros2', '--out', 'bag'])")
    without_torch("import embodied_depth_trainer.exports.lerobot.dataset, embodied_depth_trainer.exports.ros2.bag")
    without_torch("parser('catalogue').parse_args(['catalogue', 'query', 'SELECT 1', '--store', 'store'])")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_its_functions(name: str) -> None:
    pytest.importorskip("torch")
    command = parser(name)
    assert command.prog == "embodied-depth"
