"""The ticks of a segment, one after the other, with all messages that belong to each."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from mcap.records import Channel, Message, Schema
from numpy.typing import NDArray

from embodied_depth_trainer.data.messages import (
    DECISION,
    EVENTS,
    FORMAT_VERSION,
    HEADER,
    IMAGE,
    MAP,
    SCAN,
    SNAPSHOT,
    TICK,
    TRUTH,
    BrokenError,
    Decoder,
    messages,
)
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.grid import Grid
from embodied_depth_trainer.exports.png import RgbPng
from embodied_depth_trainer.exports.poses import IDENTITY, Pose, number
from embodied_depth_trainer.exports.sentences import Sentence

# The messages that a tick can promise, by the key of the promise.
_PARTS = {"scan": SCAN, "frame": IMAGE, "truth": TRUTH, "decision": DECISION, "snapshot": SNAPSHOT}
_DECODED = {SCAN, IMAGE, MAP, EVENTS}


class Log(Protocol):
    """The fields used of `foxglove.Log`; the class itself comes from the recording's schema."""

    level: int
    message: str


@dataclass
class Tick:
    """A tick of the robot's loop."""

    recorded: dict[str, Any]
    """Its first message: time, wheel feedback, and which other messages belong to it."""
    ranges: NDArray[np.float64] | None = None
    image: RgbPng | None = None
    decision: dict[str, Any] | None = None
    grid: Grid | None = None
    logged: list[Sentence] = field(default_factory=list)
    topics: set[str] = field(default_factory=set)
    """The topics of the messages that were read."""

    @property
    def number(self) -> int:
        return int(self.recorded["tick"])

    @property
    def time_ns(self) -> int:
        """Monotonic."""
        return int(self.recorded["time_ns"])

    @property
    def wheel(self) -> dict[str, Any]:
        wheel: dict[str, Any] = self.recorded["wheel"]
        return wheel

    @property
    def twist(self) -> tuple[float, float]:
        """The speeds that the wheels measured, m/s and rad/s."""
        return number(self.wheel["linear_mps"]), number(self.wheel["angular_radps"])

    @property
    def t_odom_base(self) -> Pose:
        """As localized; by wheel odometry alone where the tick has no decision."""
        return Pose.of(self.wheel if self.decision is None else self.decision["t_odom_base"])

    @property
    def t_map_odom(self) -> Pose:
        return IDENTITY if self.decision is None else Pose.of(self.decision["t_map_odom"])

    @property
    def t_map_base(self) -> Pose:
        """As localized; by wheel odometry alone where the tick has no decision."""
        t_odom_base = self.t_odom_base
        return t_odom_base if self.decision is None else self.t_map_odom.compose(t_odom_base)

    def missing(self) -> str | None:
        """The topic of a message that the tick promises and that was not read."""
        promised = (topic for key, topic in _PARTS.items() if self.recorded.get(key))
        return next((topic for topic in promised if topic not in self.topics), None)


class Segment:
    """One segment that is being read."""

    def __init__(self, file: Path, read: Callable[[int], object] | None = None) -> None:
        self.file = file
        self.header: dict[str, Any] = {}
        self.is_cut = False
        """Whether it ends early; known when all ticks were read."""
        self._read = read
        self._decoder = Decoder(file)

    def ticks(self) -> Iterator[Tick]:
        """The complete ticks. Raises a `TrainerError` for anything but a missing end, because it is unknown what else
        of a damaged segment is wrong."""
        tick: Tick | None = None
        previous: int | None = None
        try:
            for schema, channel, message in messages(self.file, self._read):
                if not self.header:
                    self.header = _header(self.file, channel, message)
                elif channel.topic == TICK:
                    if tick is not None:
                        yield self._complete(tick)
                        previous = tick.number
                    tick = Tick(_json(self.file, channel, message))
                    if previous is not None and tick.number <= previous:
                        raise TrainerError(f"{self.file}: tick {tick.number} follows tick {previous}; ticks count up")
                elif tick is not None:
                    self._add(tick, schema, channel, message)
        except BrokenError as problem:
            if not problem.is_cut:
                raise TrainerError(_damaged(self.file, problem)) from None
            self.is_cut = True
            # The chunk with its other messages may be the one that is missing.
            if tick is not None and tick.missing() is not None:
                return
        if not self.header and not self.is_cut:
            raise TrainerError(f"{self.file} holds no {HEADER}: it is no recording of this robot")
        if tick is not None:
            yield self._complete(tick)

    def _complete(self, tick: Tick) -> Tick:
        missing = tick.missing()
        if missing is not None:
            raise TrainerError(
                f"{self.file}: tick {tick.number} has no message on {missing}, and it should; use the recording as the "
                "robot wrote it"
            )
        return tick

    def _add(self, tick: Tick, schema: Schema | None, channel: Channel, message: Message) -> None:
        tick.topics.add(channel.topic)
        if channel.topic == DECISION:
            tick.decision = _json(self.file, channel, message)
        elif channel.topic in _DECODED:
            content = self._decoder.decode(schema, channel, message)
            if channel.topic == SCAN:
                tick.ranges = np.asarray(content.ranges, np.float64)
            elif channel.topic == IMAGE:
                tick.image = self._image(tick, content.data)
            elif channel.topic == MAP and message.log_time == tick.time_ns:
                tick.grid = Grid.of(content)
            elif channel.topic == EVENTS:
                tick.logged.append(Sentence.logged(content.level, content.message))

    def _image(self, tick: Tick, data: bytes) -> RgbPng:
        try:
            return RgbPng.of(data)
        except ValueError as problem:
            raise TrainerError(f"{self.file}: the image of tick {tick.number} cannot be read: {problem}") from None


def read_header(file: Path) -> dict[str, Any] | None:
    """The first message of a segment; `None` when the segment is cut before it."""
    try:
        for _, channel, message in messages(file):
            return _header(file, channel, message)
    except BrokenError as problem:
        if not problem.is_cut:
            raise TrainerError(_damaged(file, problem)) from None
    return None


def _damaged(file: Path, problem: BrokenError) -> str:
    return f"{file} is damaged ({problem}); copy it again, or export what `firmware-host buffer recover` keeps of it"


def _json(file: Path, channel: Channel, message: Message) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(message.data)
    except ValueError as problem:
        raise TrainerError(f"{file}: a message on {channel.topic} is no JSON: {problem}") from None
    return found


def _header(file: Path, channel: Channel, message: Message) -> dict[str, Any]:
    if channel.topic != HEADER:
        raise TrainerError(f"{file} does not begin with {HEADER}: it is no recording of this robot")
    header = _json(file, channel, message)
    version = header.get("format_version")
    if version != FORMAT_VERSION:
        raise TrainerError(f"{file} has format version {version}, and this reads {FORMAT_VERSION}; update the trainer")
    return header
