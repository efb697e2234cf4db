"""Compares an export with the recording it was made of: `compare_with_lerobot.py DATASET RUN`.

The dataset is read with LeRobot's own class and the recording with the `mcap` package, without any code of this project.
"""

import io
import json
import sys
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from mcap.reader import make_reader
from PIL import Image


def recorded(run: Path):
    """Yields (tick, image, decision) of every tick that has all three."""
    for segment in sorted(run.glob("recording_*.mcap")):
        tick = image = None
        with segment.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                if channel.topic == "/robot/tick":
                    tick, image = json.loads(message.data), None
                elif channel.topic == "/camera/image":
                    # The PNG inside foxglove.CompressedImage.
                    start, end = message.data.index(b"\x89PNG"), message.data.index(b"IEND") + 8
                    image = np.asarray(Image.open(io.BytesIO(message.data[start:end])).convert("RGB"))
                elif channel.topic == "/robot/decision" and image is not None:
                    yield tick, image, json.loads(message.data)


def main() -> None:
    root, run = Path(sys.argv[1]), Path(sys.argv[2])
    dataset = LeRobotDataset(repo_id="local/run", root=root)
    rows = list(recorded(run))
    assert len(rows) == len(dataset), (len(rows), len(dataset))
    for index, (tick, image, decision) in enumerate(rows):
        frame, wheel, command = dataset[index], tick["wheel"], decision["command"]
        seen = (frame["observation.images.front"].permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
        assert np.array_equal(seen, image), index
        state = [wheel[key] for key in ("x_m", "y_m", "yaw_rad", "linear_mps", "angular_radps")]
        assert np.array_equal(frame["observation.state"].numpy(), np.float32(state)), index
        action = [command["linear_mps"], command["angular_radps"]]
        assert np.array_equal(frame["action"].numpy(), np.float32(action)), index
        if int(frame["frame_index"]) == 0:
            start_ns = tick["time_ns"]
        # LeRobot converts it to 32 bits.
        assert np.isclose(float(frame["time_s"]), (tick["time_ns"] - start_ns) * 1e-9, rtol=1e-6), index
        # LeRobot's own tolerance.
        assert abs(float(frame["timestamp"]) - int(frame["frame_index"]) / dataset.fps) < 1e-4, index
    actions = np.stack([dataset[index]["action"].numpy() for index in range(len(dataset))]).astype(np.float64)
    stats, images = dataset.meta.stats, np.stack([image for _, image, _ in rows]) / 255
    for key, expected in {"mean": actions.mean(0), "std": actions.std(0), "q10": np.quantile(actions, 0.1, axis=0)}.items():
        assert np.allclose(stats["action"][key], expected, atol=1e-9), key
    for key, expected in {"mean": images.mean((0, 1, 2)), "q90": np.quantile(images, 0.9, axis=(0, 1, 2))}.items():
        assert np.allclose(stats["observation.images.front"][key][:, 0, 0], expected, atol=1e-6), key
    step = 1 / dataset.fps
    steps = LeRobotDataset("local/run", root=root, delta_timestamps={"action": [0.0, step, 2 * step]})
    assert steps[0]["action"].shape == (3, 2)
    last = LeRobotDataset("local/run", root=root, episodes=[dataset.num_episodes - 1])
    assert 0 < len(last) <= len(dataset)
    print(f"{len(dataset)} frames in {dataset.num_episodes} episodes equal the recording; task: {dataset[0]['task']}")


if __name__ == "__main__":
    main()
