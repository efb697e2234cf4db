"""The card of a dataset: what its shards say about themselves, and whether their images may show a home."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from embodied_depth_trainer.data.held_out import PER_MILLE
from embodied_depth_trainer.sharing.cards import TAG, UNKNOWN, CardOptions, front_matter, license_section, table
from embodied_depth_trainer.store.arrays import ArrayFolder
from embodied_depth_trainer.store.listing import segments_in
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import DatasetVersion

KEY_DIGITS = 16
# Upper limits of a hub's size categories.
SIZES = {1_000: "n<1K", 10_000: "1K<n<10K", 100_000: "10K<n<100K", 1_000_000: "100K<n<1M"}
LARGEST = "n>1M"
NS_PER_MIN = 60e9


class Contents:
    """What the shards of a dataset say about themselves."""

    def __init__(self, version: DatasetVersion, stores: Sequence[Store]) -> None:
        self.version = version
        shards = [segment.open()[0] for segment in segments_in(version, stores)]
        self.metas: list[dict[str, Any]] = [shard.meta for shard in shards]
        self.minutes = sum(_minutes(shard) for shard in shards)
        self.recipes = {store.recipe_digest: store.recipe for store in stores if store.recipe_digest in version.recipes}

    @property
    def may_show_homes(self) -> bool:
        """Whether images may be of a real place: those that no simulation says it made."""
        return bool(self.version.dumps) or None in self.scenes

    @property
    def scenes(self) -> list[str | None]:
        """The simulated world of each segment; `None` on a real robot."""
        return [meta["recorded"].get("scene") for meta in self.metas]

    def total(self, key: str) -> float:
        return float(sum(meta[key] for meta in self.metas))


def dataset_card(contents: Contents, options: CardOptions) -> str:
    """The card in Markdown."""
    version = contents.version
    frames = version.summary["frames"]
    size = next((name for limit, name in SIZES.items() if frames < limit), LARGEST)
    front = front_matter(
        {
            "license": options.license,
            "pretty_name": f"Embodied Depth {version.name}",
            "task_categories": ["depth-estimation", "robotics"],
            "size_categories": [size],
            "tags": [TAG],
        }
    )
    sections = [
        front,
        f"# Dataset {version.name}",
        "Recordings of a robot, prepared by Embodied Depth as shards that a training reads: images, coarse depth, "
        "poses and LiDAR hits. This card was written from the shards; where they say nothing, the card says so.",
        f"## Privacy\n\n{_privacy(contents)}",
        f"## What is in it\n\n{_counts(contents)}",
        f"## Camera\n\n{_cameras(contents)}",
        f"## How it was made\n\n{_recipes(contents)}",
        f"## Use\n\n{_use(version)}",
        license_section(options.license),
    ]
    return "\n\n".join(sections) + "\n"


def _minutes(shard: ArrayFolder) -> float:
    """From the first to the last frame."""
    times = shard.load("time", np.int64)
    return float(times[-1] - times[0]) / NS_PER_MIN


def _privacy(contents: Contents) -> str:
    if not contents.may_show_homes:
        return "All images are simulated, as the recordings say. None shows a real place."
    real = contents.scenes.count(None)
    dumps = (
        f", and {len(contents.version.dumps)} dumps do not say where they are from" if contents.version.dumps else ""
    )
    return (
        f"**Images may show a real home.** {real} of {len(contents.metas)} segments name no simulated world, as those "
        f"of a real robot{dumps}. Treat them as private: ask everyone who lives there before you pass them on. "
        "`meta.json` of a shard names the robot and its site if the recording does, and says when it was made."
    )


def _counts(contents: Contents) -> str:
    version = contents.version
    frames = sum(meta["frames"] for meta in contents.metas)
    held_out = f"{100 * contents.total('held_out') / frames:.1f} %" if frames else "none"
    events = sum((Counter(meta["events"]) for meta in contents.metas), Counter[str]())
    worlds = _listed(scene for scene in contents.scenes if scene is not None)
    rows = [
        ("robots", _robots(contents)),
        ("runs", len({shard.folder for shard in version.shards})),
        ("segments", len(contents.metas)),
        ("frames", frames),
        ("minutes", f"{contents.minutes:.2f}, from the first to the last frame of each segment"),
        ("path, m", f"{contents.total('length_m'):.1f}"),
        ("simulated worlds", worlds or "none is named"),
        ("policies", _listed(meta["recorded"].get("policy") for meta in contents.metas) or UNKNOWN),
        ("frames of held-out places", f"{held_out}; trainings leave them out (one of {1000 // PER_MILLE} places)"),
        ("segments that end in damage", sum(meta["damage"] is not None for meta in contents.metas)),
        ("events", ", ".join(f"{kind} {count}" for kind, count in events.most_common()) or "none"),
        *(
            [("dumps", f"{len(version.dumps)} with {sum(dump.frames for dump in version.dumps)} frames")]
            * bool(version.dumps)
        ),
    ]
    return table(("", ""), rows)


def _robots(contents: Contents) -> str:
    identities = [meta["recorded"].get("identity") or {} for meta in contents.metas]
    named = _listed(_robot(identity) for identity in identities if "robot" in identity)
    silent = sum("robot" not in identity for identity in identities)
    return "; ".join(filter(None, [named, f"{silent} segments do not say which robot" if silent else ""]))


def _robot(identity: dict[str, Any]) -> str:
    return f"{identity.get('name') or 'no name'} (public key {identity['robot'][:KEY_DIGITS]}...)"


def _listed(values: Iterable[str | None]) -> str:
    """Each value once, in order."""
    return ", ".join(sorted({value for value in values if value is not None}))


def _cameras(contents: Contents) -> str:
    counted: Counter[str] = Counter()
    for meta in contents.metas:
        counted[json.dumps(meta["camera"])] += meta["frames"]
    rows = []
    for text, frames in counted.items():
        camera = json.loads(text)
        numbers = [f"{camera[key]:.6g}" for key in ("fx", "fy", "cx", "cy")]
        rows.append([f"{camera['height']}x{camera['width']}", *numbers, frames])
    return table(("rows x columns", "fx", "fy", "cx", "cy", "frames"), rows)


def _recipes(contents: Contents) -> str:
    made = "\n\n".join(
        table(("", ""), [(f"recipe {digest[:KEY_DIGITS]}", ""), *_recipe(recipe)])
        for digest, recipe in contents.recipes.items()
    )
    return (
        f"{made}\n\nPoses (`pose.npy`, `camera_optical` in `odom`, metres) are those that the robot's own localization "
        "had at each exposure; no other system measured them. No shard holds ground truth of depth, also not one of a "
        "simulation."
    )


def _recipe(recipe: dict[str, Any]) -> list[tuple[str, str]]:
    size = recipe["size"]
    return [
        ("coarse depth", recipe["coarse"]),
        ("program that computed it", recipe["engine"] or "none"),
        ("images reduced to", "not reduced" if size is None else f"{size[0]}x{size[1]}"),
        ("labels", "from motion over the whole recording" if recipe["labels"] else "none"),
        ("network that added labels", recipe["teacher"] or "none"),
    ]


def _use(version: DatasetVersion) -> str:
    return f"""    embodied-depth hub download OWNER/NAME --type dataset --expect {version.name} --out store
    embodied-depth train --store store --only store/frozen/{version.name}.json --network student --steps 3000 \\
        --out training

Each array is a NumPy file `[N, ...]` in `shards/NAME/`, whose digests are in `SHA256SUMS` beside it:

```python
import numpy
rgb = numpy.load("store/shards/NAME/rgb.npy", mmap_mode="r")  # uint8 [N, H, W, 3]
```"""
