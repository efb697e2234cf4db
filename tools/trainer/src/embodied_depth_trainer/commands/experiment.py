"""Experiment files: the options of a command as TOML.

    network = "student"                 # --network student
    recording = ["runs/a", "runs/b"]    # --recording runs/a --recording runs/b
    baseline = [0.05, 0.30]             # --baseline 0.05 0.30
    auto_mask = true                    # --auto-mask

They are inserted before the typed options. `train` writes its own options into `experiment.toml` beside the
checkpoint; that file starts the same training again.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError


def read(file: Path) -> list[str]:
    """The options of the file as command-line arguments."""
    try:
        values = tomllib.loads(file.read_text())
    except OSError as problem:
        raise TrainerError(f"cannot read {file}: {problem}; give an experiment's TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise TrainerError(f"{file} is not valid TOML: {problem}") from None
    return [word for name, value in values.items() for word in _arguments(file, name, value)]


def _arguments(file: Path, name: str, value: object) -> list[str]:
    option = "--" + name.replace("_", "-")
    match value:
        case True:
            return [option]
        case False:
            # Only this option has a `--no-` form.
            return ["--no-" + option[2:]] if name == "auto_mask" else []
        case str() | int() | float():
            return [option, str(value)]
        case [str(), *_]:
            return [word for item in value for word in (option, str(item))]
        case [int() | float(), *_]:
            return [option, *map(str, value)]
        case []:
            return []
    raise TrainerError(
        f"{file}: `{name} = {value}` cannot be an option; give a string, a number, true, false or a list"
    )


def to_toml(options: Mapping[str, Any]) -> str:
    """The options as TOML, without those that have no value."""
    lines = []
    for name, value in options.items():
        if name == "size" and value is not None:
            lines.append(f'size = "{value[0]}x{value[1]}"')
        elif isinstance(value, tuple | list):
            items = [str(item) if isinstance(item, Path) else item for item in value]
            # JSON's strings, numbers and lists are valid TOML.
            lines.append(f"{name} = {json.dumps(items, ensure_ascii=False)}")
        elif isinstance(value, Path):
            lines.append(f"{name} = {json.dumps(str(value), ensure_ascii=False)}")
        elif value is not None:
            lines.append(f"{name} = {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines) + "\n"
