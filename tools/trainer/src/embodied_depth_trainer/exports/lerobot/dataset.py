"""The export of a run as a dataset.

LeRobot requires every frame at `frame_index / fps` to 0.1 ms, which a control loop under load does not keep. The
column `timestamp` is therefore exactly `frame_index / fps`, and the column `time_s` is the real time in seconds since
the first frame of the episode. A gap longer than `BREAK_NS` starts a new episode, so that no step within an episode
spans a gap.

`action` is the command that was sent to the base: what left the safety loop, not what the planner desired. The safety
loop sends about ten commands from one tick to the next; the action of a frame is the one that was in force when the
next tick began. A frame without a next tick, at the end of a run or before a gap, is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.lerobot import meta
from embodied_depth_trainer.exports.lerobot.layout import MAX_DATA_FILE, ROW_GROUP, Episode, Place, is_step
from embodied_depth_trainer.exports.lerobot.rows import Rows, Vector, action_before, state_of
from embodied_depth_trainer.exports.lerobot.tables import DataTable
from embodied_depth_trainer.exports.png import RgbPng
from embodied_depth_trainer.exports.runs import Run
from embodied_depth_trainer.exports.summary import Summary
from embodied_depth_trainer.exports.ticks import Segment, Tick


def export(run: Run, folder: Path, read: Callable[[int], object] | None = None) -> Summary:
    """Writes the run into the new folder. `read` is called with the number of bytes that were read since the last
    call."""
    dataset = Dataset(folder)
    cut = []
    try:
        for file in run.segments:
            segment = Segment(file, read)
            for tick in segment.ticks():
                dataset.add(segment.header, tick)
            if segment.is_cut:
                cut.append(file)
        counts = dataset.finish(run.path)
    finally:
        dataset.close()
    return Summary(
        f"{counts.episodes} episodes, {counts.frames} images, {counts.left_out} left out without odometry or a command",
        cut,
    )


@dataclass
class Counts:
    """Of an export."""

    episodes: int = 0
    """Spans of the run without a gap."""
    frames: int = 0
    """Images with the state and the action at their time."""
    left_out: int = 0
    """Images whose tick has no pose, or which no tick follows that holds their command."""


@dataclass(frozen=True)
class _Frame:
    """A frame without its action, which the next tick brings."""

    tick: int
    time_ns: int
    image: RgbPng
    state: Vector


class Dataset:
    """A dataset that is being written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.counts = Counts()
        self._header: dict[str, Any] = {}
        self._rows = Rows()
        self._fps: int | None = None
        """Computed from the first row group."""
        self._table: DataTable | None = None
        self._place = Place(0)
        self._episodes: list[Episode] = []
        self._last_ns: int | None = None
        self._newest: _Frame | None = None

    def add(self, header: dict[str, Any], tick: Tick) -> None:
        """The next tick of the run."""
        self._header = self._header or header
        newest, self._newest = self._newest, None
        if newest is not None:
            is_next = tick.number == newest.tick + 1 and is_step(tick.time_ns - newest.time_ns)
            action = action_before(tick) if is_next else None
            if action is None:
                self.counts.left_out += 1
            else:
                self._push(newest, action)
        if tick.image is None:
            return
        state = state_of(tick) if self._rows.fits(tick.image) else None
        if state is None:
            self.counts.left_out += 1
        else:
            self._newest = _Frame(tick.number, tick.time_ns, tick.image, state)

    def finish(self, run: Path) -> Counts:
        """Writes what is left, and the files that describe the dataset."""
        self.counts.left_out += self._newest is not None
        size = self._rows.size
        if size is None:
            raise TrainerError(f"{run}: no image has a pose and a command, so there is nothing to export")
        self._flush()
        # Flushed before, because rows of the last episode are still waiting.
        self._end_episode()
        self.close()
        self.counts.episodes, self.counts.frames = len(self._episodes), self._rows.total
        self._describe(size)
        return self.counts

    def close(self) -> None:
        table, self._table = self._table, None
        if table is not None:
            table.close()

    def _push(self, frame: _Frame, action: Vector) -> None:
        if self._last_ns is not None and not is_step(frame.time_ns - self._last_ns):
            self._end_episode()
        self._last_ns = frame.time_ns
        try:
            self._rows.push(frame.time_ns, frame.image, frame.state, action, len(self._episodes))
        except (OSError, ValueError) as problem:
            raise TrainerError(f"the image of tick {frame.tick} is damaged: {problem}") from problem
        if self._rows.waiting >= ROW_GROUP:
            self._flush()

    def _flush(self) -> None:
        """Writes the collected rows as a row group."""
        if self._rows.waiting == 0:
            return
        self._fps = self._fps or self._rows.frames_per_second()
        if self._table is None:
            self._table = DataTable(self.folder / self._place.path)
        self._rows.write(self._fps, self._table.append)

    def _end_episode(self) -> None:
        begin = self._episodes[-1].end if self._episodes else 0
        self._episodes.append(Episode(begin, self._rows.total, self._place, self._rows.start_ns * 1e-9))
        self._rows.begin_episode()
        if self._table is not None and self._table.bytes + self._rows.waiting_bytes > MAX_DATA_FILE:
            self._flush()
            self.close()
            self._place = Place(self._place.number + 1)

    def _describe(self, size: tuple[int, int]) -> None:
        run = self._header["run"]
        task = f"explore a home by the policy {run['policy']}"
        meta.write_episodes(self.folder, self._episodes, task)
        meta.write_tasks(self.folder, task)
        described = meta.info(len(self._episodes), self._rows.total, self._fps or 1, size)
        meta.write_json(self.folder, "info.json", described)
        meta.write_json(self.folder, "stats.json", self._rows.stats())
        # The camera model, its mounting pose and the configuration, for which LeRobot has no fields.
        meta.write_json(self.folder, "run.json", run)
