"""Replaces `firmware-host perceive` in tests: coarse depth of a recording that shows the room of seed 0, without
PyTorch, which takes seconds to start. `python -m tests.fake_engine --recording RUN --dump DIR`."""

from __future__ import annotations

import argparse
import json
import struct
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from embodied_depth_trainer.data.frames import Frames
from embodied_depth_trainer.files import write_atomically

from .rooms import room

# Time from one frame to the next.
STEP_NS = 100_000_000


def dump(folder: Path, frames: Frames, begin: int) -> None:
    """Writes planes first and then the index of all planes so far, as the robot does."""
    folder.mkdir(exist_ok=True)
    assert frames.coarse is not None
    file = folder / "dump.json"
    entries = json.loads(file.read_text())["frames"] if file.exists() else []
    assert frames.dense is not None
    for index, (coarse, dense) in enumerate(zip(frames.coarse, frames.dense, strict=True), begin):
        np.save(folder / f"{index:06}.npy", coarse)
        np.save(folder / f"{index:06}_dense.npy", dense)
        entries.append({"name": f"{index:06}", "time_ns": index * STEP_NS, "coarse": True, "dense": True})
    text = json.dumps({"format_version": 1, **asdict(frames.camera), "frames": entries})
    write_atomically(text.encode(), file)


def messages(file: Path) -> Iterator[tuple[str, bytes]]:
    """Topic and content of all messages up to the end of the file or to damage."""
    topics: dict[int, str] = {}
    with file.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    yield topics[record.channel_id], record.data
        except (McapError, struct.error):
            return


def perceive(recording: Path, folder: Path) -> None:
    """Writes coarse depth of a run, or of one of its segments."""
    files = sorted(recording.glob("*.mcap")) if recording.is_dir() else [recording]
    times = []
    size = (0, 0)
    for topic, data in (message for file in files for message in messages(file)):
        if topic == "/robot/header":
            camera = json.loads(data)["run"]["camera"]
            size = (camera["height"], camera["width"])
        elif topic == "/robot/tick":
            times.append(json.loads(data)["time_ns"] // STEP_NS)
    dump(folder, room(times[-1] + 1, size).at(slice(times[0], None)), times[0])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    for name in ("--recording", "--dump", "--out"):
        parser.add_argument(name, type=Path, required=True)
    parser.add_argument("--restart-every")
    options = parser.parse_args()
    perceive(options.recording, options.dump)
