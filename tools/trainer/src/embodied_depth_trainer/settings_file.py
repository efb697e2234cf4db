"""What the work in a folder was begun with: it goes on with the same, or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .checkpoint import write_atomically
from .errors import TrainerError

SETTINGS_FILE = "settings.json"


def same_settings(settings: dict[str, Any], out: Path) -> None:
    """Writes the settings, or finds those that are there to be the same."""
    file = out / SETTINGS_FILE
    now = json.loads(json.dumps(settings))
    if not file.exists():
        write_atomically(json.dumps(now, indent=2).encode(), file)
        return
    was = json.loads(file.read_text())
    different = {key: (was.get(key), now[key]) for key in now if was.get(key) != now[key]}
    if different:
        said = ", ".join(f"{key} was {old}, now {new}" for key, (old, new) in different.items())
        raise TrainerError(f"{file}: {said}; give the same, or another --out")
