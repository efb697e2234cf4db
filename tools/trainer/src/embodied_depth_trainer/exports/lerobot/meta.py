"""The files below `meta/`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from embodied_depth_trainer.exports.lerobot.layout import (
    ACTION,
    ACTION_NAMES,
    CHUNK_FILES,
    EPISODE_FILE,
    IMAGE,
    MAX_DATA_FILE,
    STATE,
    STATE_NAMES,
    TASKS_FILE,
    TIME,
    Episode,
)
from embodied_depth_trainer.exports.lerobot.tables import write_table


def info(episodes: int, frames: int, fps: int, size: tuple[int, int]) -> dict[str, Any]:
    """`info.json`, for images of `size` rows x columns."""
    features = {
        IMAGE: _feature("image", [*size, 3], ["height", "width", "channels"]),
        STATE: _feature("float32", [len(STATE_NAMES)], list(STATE_NAMES)),
        ACTION: _feature("float32", [len(ACTION_NAMES)], list(ACTION_NAMES)),
        TIME: _feature("float64", [1], None),
        "timestamp": _feature("float32", [1], None),
    }
    for name in ("frame_index", "episode_index", "index", "task_index"):
        features[name] = _feature("int64", [1], None)
    return {
        "codebase_version": "v3.0",
        "robot_type": "embodied-depth",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": MAX_DATA_FILE >> 20,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }


def _feature(dtype: str, shape: list[int], names: list[str] | None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "names": names}


def write_episodes(folder: Path, episodes: Sequence[Episode], task: str) -> None:
    """The table of episodes: where each one is in the data files."""
    numbers: dict[str, list[int]] = {
        "length": [episode.end - episode.begin for episode in episodes],
        "data/chunk_index": [episode.place.chunk for episode in episodes],
        "data/file_index": [episode.place.file for episode in episodes],
        "dataset_from_index": [episode.begin for episode in episodes],
        "dataset_to_index": [episode.end for episode in episodes],
        "meta/episodes/chunk_index": [0] * len(episodes),
        "meta/episodes/file_index": [0] * len(episodes),
    }
    tasks = pa.array([[task]] * len(episodes), pa.list_(pa.field("element", pa.string(), nullable=False)))
    # Not part of LeRobot's format: the start on the run's clock, to find the episode in the recording.
    starts = pa.array([episode.start_s for episode in episodes], pa.float64())
    columns = {"episode_index": pa.array(range(len(episodes)), pa.int64()), "tasks": tasks}
    columns |= {name: pa.array(values, pa.int64()) for name, values in numbers.items()}
    write_table(folder / EPISODE_FILE, {**columns, "start_time_s": starts})


def write_tasks(folder: Path, task: str) -> None:
    """The table with the only task, in the form in which pandas writes a frame that is indexed by task."""
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [
            {
                "name": None,
                "field_name": None,
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": {"encoding": "UTF-8"},
            }
        ],
        "columns": [_pandas_column("task_index", "int64", "int64"), _pandas_column("task", "unicode", "object")],
        "pandas_version": "2.2.0",
    }
    columns = {"task_index": pa.array([0], pa.int64()), "task": pa.array([task], pa.string())}
    write_table(folder / TASKS_FILE, columns, pandas)


def _pandas_column(name: str, pandas_type: str, numpy_type: str) -> dict[str, Any]:
    return {
        "name": name,
        "field_name": name,
        "pandas_type": pandas_type,
        "numpy_type": numpy_type,
        "metadata": None,
    }


def write_json(folder: Path, name: str, value: dict[str, Any]) -> None:
    """A JSON file below `meta/`."""
    (folder / "meta" / name).write_text(json.dumps(value, indent=2))
