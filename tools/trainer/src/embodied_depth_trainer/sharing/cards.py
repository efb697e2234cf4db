"""What the cards of networks and datasets have in common: front matter in YAML, tables, and what the user adds."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

UNKNOWN = "the file does not say"
# What hubs list all cards of this program under.
TAG = "embodied-depth"


@dataclass(frozen=True)
class CardOptions:
    """What only the user knows."""

    license: str | None = None
    base_model: str | None = None
    """Repository of the network that the training began with. A file knows only its name and digest."""
    datasets: tuple[str, ...] = ()
    """Repositories of the datasets."""
    results: Path | None = None
    """Numbers that `evaluate --json` wrote."""
    measured_on: str | None = None
    """What these numbers were measured on."""


def front_matter(values: Mapping[str, str | Sequence[str] | None]) -> str:
    """The lines that a hub reads. Values are written as in JSON, which is YAML too; what is not known is left out."""
    known = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in values.items() if value]
    return "\n".join(["---", *known, "---"])


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(_cell(value) for value in line)} |" for line in lines)


def _cell(value: object) -> str:
    return " ".join(str(value).replace("|", "\\|").split())


def license_section(license_name: str | None) -> str:
    said = (
        f"`{license_name}`, as the person says who published this."
        if license_name
        else "No licence was given, so this card grants none: ask the person who published this."
    )
    return f"## Licence\n\n{said}"
