"""Networks and datasets from a hub, which are checked before they appear under their names."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from pathlib import Path

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.sharing.examination import examine
from embodied_depth_trainer.sharing.hub import Snapshot, download_all, download_file
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import DatasetVersion, read_version

CARD_FILE = "README.md"
# The files of a dataset, as `publish.py` makes them.
DATASET_PATTERNS = ("recipe.json", "runs/*", "frozen/*", "shards/*", "labels/*")
_NAME = r"\w[\w.-]*"
_DATASET_FILE = re.compile(
    rf"recipe\.json|(runs|frozen)/{_NAME}\.json|(shards|labels)/{_NAME}/(\w+\.npy|meta\.json|SHA256SUMS)", re.ASCII
)
# Where the library keeps what it knows about a download that was interrupted.
LIBRARY_FOLDER = ".cache/huggingface"


def download_model(found: Snapshot, name: str | None, expected: str | None, out: Path) -> tuple[Path, str]:
    """Downloads a network and its card into a folder. Returns the network's file and its SHA-256."""
    name = _network(found, name)
    wanted = [name] + ([CARD_FILE] if CARD_FILE in found.digests else [])
    places = {part: out / Path(part).name for part in wanted}
    for place in places.values():
        if place.exists():
            raise TrainerError(f"{place} exists and is not replaced; move it away or give another --out")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".download-") as folder:
        files = {part: download_file(found, part, Path(folder)) for part in wanted}
        digest = hashlib.sha256(files[name].read_bytes()).hexdigest()
        if expected is not None and digest != expected.lower():
            raise TrainerError(
                f"{name} of {found.repository} has the SHA-256 {digest}, expected {expected}; do not use it"
            )
        examine(files[name])
        for part, place in places.items():
            os.replace(files[part], place)
    return places[name], digest


def _network(found: Snapshot, name: str | None) -> str:
    """The ONNX file to download."""
    networks = sorted(path for path in found.digests if path.endswith(".onnx") and ".." not in path.split("/"))
    if name is None and len(networks) == 1:
        return networks[0]
    if name not in networks:
        what = f"has no network {name}" if name is not None else f"has {len(networks)} networks"
        raise TrainerError(f"{found.repository} {what}; its networks are {', '.join(networks) or 'none'} (--file NAME)")
    return name


def download_dataset(found: Snapshot, expected: str | None, out: Path) -> DatasetVersion:
    """Downloads a dataset as a store, and compares all of it with the digests of its version."""
    names = [path for path in found.digests if path == "recipe.json" or "/" in path]
    odd = [path for path in names if not _DATASET_FILE.fullmatch(path)]
    if odd or "recipe.json" not in names:
        raise TrainerError(
            f"{found.repository} is no store of shards: {f'it holds {odd[0]}' if odd else 'it has no recipe.json'}; "
            "give a repository that `embodied-depth hub upload` filled"
        )
    # The list is named by its version, so that nothing else has to be downloaded first.
    listed = [path for path in names if path.startswith("frozen/")]
    if len(listed) != 1:
        raise TrainerError(f"{found.repository} lists {len(listed)} datasets instead of one; upload it again")
    held = Path(listed[0]).stem
    if expected is not None and held != expected:
        raise TrainerError(f"{found.repository} holds dataset {held}, expected {expected}; do not use it")
    if out.exists() and any(out.iterdir()) and not (out / LIBRARY_FOLDER).is_dir():
        raise TrainerError(f"{out} is not empty; give another --out, or one whose download was interrupted")
    # Images of a home are private.
    out.mkdir(mode=0o700, parents=True, exist_ok=True)
    download_all(found, [*DATASET_PATTERNS, CARD_FILE], out)
    for name in names:
        found.check(name, out / name)
    version = read_version(out / listed[0])
    if version.name != held:
        raise TrainerError(f"{out / listed[0]} lists dataset {version.name}; do not use it")
    open_dataset([Store(out)], only=version)
    return version
