"""Compares a dataset of `embodied-depth convert --as lerobot` with the recording that it was made of. The dataset is read with
LeRobot's own class, and the recording with the `mcap` package, without any code of this project. Called by
tools/trainer/tests/exports/test_peers.py with the Python that LEROBOT_PYTHON names; it needs `lerobot` and `mcap`:

    python tests/peers/lerobot_dataset.py DATASET RECORDING.mcap...
"""

import io
import json
import math
import os
import sys
from pathlib import Path

# The dataset is a folder, and nothing else is to be looked for.
os.environ["HF_HUB_OFFLINE"] = "1"

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from mcap.reader import make_reader
from PIL import Image

BREAK_NS = 1_000_000_000


def ticks(recordings):
    """The ticks of a run: what each holds, with its decision and its image."""
    tick = None
    for recording in recordings:
        with recording.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                if channel.topic == "/robot/tick":
                    if tick is not None:
                        yield tick
                    tick = json.loads(message.data) | {"rgb": None, "decision": None}
                elif channel.topic == "/camera/image":
                    # The PNG inside foxglove.CompressedImage.
                    start, end = message.data.index(b"\x89PNG"), message.data.index(b"IEND") + 8
                    tick["rgb"] = np.asarray(Image.open(io.BytesIO(message.data[start:end])).convert("RGB"))
                elif channel.topic == "/robot/decision":
                    tick["decision"] = json.loads(message.data)
    yield tick


def expected(recordings):
    """Yields (tick, command) of every tick with an image, a decision, and a next tick that holds the command that answered it."""
    before = None
    for tick in ticks(recordings):
        is_next = before is not None and tick["tick"] == before["tick"] + 1
        if is_next and 0 < tick["time_ns"] - before["time_ns"] <= BREAK_NS:
            sent = tick["decision"] and tick["decision"]["sent"]
            if sent and before["decision"] and before["rgb"] is not None:
                yield before, sent
        before = tick


def t_map_base(decision):
    """The localized pose: `odom` in `map`, then the robot in `odom`."""
    origin, base = decision["t_map_odom"], decision["t_odom_base"]
    cos, sin = math.cos(origin["yaw_rad"]), math.sin(origin["yaw_rad"])
    x_m = origin["x_m"] + cos * base["x_m"] - sin * base["y_m"]
    y_m = origin["y_m"] + sin * base["x_m"] + cos * base["y_m"]
    return [x_m, y_m, math.remainder(origin["yaw_rad"] + base["yaw_rad"], math.tau)]


def main():
    root, recordings = Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]
    dataset = LeRobotDataset(repo_id="local/run", root=root)
    rows = list(expected(recordings))
    assert len(rows) == len(dataset), (len(rows), len(dataset))
    episode = start_ns = None
    for index, (tick, sent) in enumerate(rows):
        frame, wheel = dataset[index], tick["wheel"]
        seen = (frame["observation.images.front"].permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
        assert np.array_equal(seen, tick["rgb"]), index
        state = [*t_map_base(tick["decision"]), wheel["linear_mps"], wheel["angular_radps"]]
        assert np.allclose(frame["observation.state"].numpy(), np.float32(state), rtol=0, atol=1e-6), index
        assert np.array_equal(frame["action"].numpy(), np.float32([sent["linear_mps"], sent["angular_radps"]])), index
        if frame["episode_index"] != episode:
            episode, start_ns = frame["episode_index"], tick["time_ns"]
            assert int(frame["frame_index"]) == 0
        # LeRobot converts it to 32 bits.
        assert np.isclose(float(frame["time_s"]), (tick["time_ns"] - start_ns) * 1e-9, rtol=1e-6), index
        # LeRobot's own tolerance.
        assert abs(float(frame["timestamp"]) - int(frame["frame_index"]) / dataset.fps) < 1e-4, index
    same_statistics(dataset, rows)
    step = 1 / dataset.fps
    steps = LeRobotDataset("local/run", root=root, delta_timestamps={"action": [0.0, step, 2 * step]})
    assert steps[0]["action"].shape == (3, 2)
    last = LeRobotDataset("local/run", root=root, episodes=[dataset.num_episodes - 1])
    assert 0 < len(last) <= len(dataset)
    print(f"{len(dataset)} frames in {dataset.num_episodes} episodes equal the recording; task: {dataset[0]['task']}")


def same_statistics(dataset, rows):
    """Of all actions, and of all pixels."""
    stats = dataset.meta.stats
    actions = np.float32([[sent["linear_mps"], sent["angular_radps"]] for _, sent in rows]).astype(np.float64)
    for key, of in {"mean": actions.mean(0), "std": actions.std(0), "q10": np.quantile(actions, 0.1, axis=0)}.items():
        assert np.allclose(stats["action"][key], of, atol=1e-9), key
    images = np.stack([tick["rgb"] for tick, _ in rows]) / 255
    for key, of in {"mean": images.mean((0, 1, 2)), "q90": np.quantile(images, 0.9, axis=(0, 1, 2))}.items():
        assert np.allclose(stats["observation.images.front"][key][:, 0, 0], of, atol=1e-6), key


if __name__ == "__main__":
    main()
