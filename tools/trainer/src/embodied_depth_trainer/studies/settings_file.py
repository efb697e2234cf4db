"""Keeps the settings of a study in its directory, so that it cannot be continued with others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.training.initial import identity

SETTINGS_FILE = "settings.json"


def plain(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings as they are stored: initial weights by name and digest instead of by path. These options are stored only
    if they are used, so that studies from before they existed stay comparable."""
    used = {**settings, "init": identity(settings["init"])}
    return {key: value for key, value in used.items() if key not in ("init", "amp") or value}


def keep_settings(settings: dict[str, Any], out: Path) -> None:
    """Writes the settings, or checks that they are equal to the existing ones."""
    file = out / SETTINGS_FILE
    now = json.loads(json.dumps(settings))
    if not file.exists():
        write_atomically(json.dumps(now, indent=2).encode(), file)
        return
    was = json.loads(file.read_text())
    different = {key: (was.get(key), now[key]) for key in now if was.get(key) != now[key]}
    if different:
        changes = ", ".join(f"{key} was {old}, now {new}" for key, (old, new) in different.items())
        raise TrainerError(f"{file}: {changes}; give the same settings or another --out")
