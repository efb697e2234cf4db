"""The messages of the robot's recordings (MCAP): which segments a run has, and what they contain, in file order.

This needs neither PyTorch nor the whole segment in memory: at most one chunk, which is about a second.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from embodied_depth_trainer.errors import TrainerError

# The recording format of the robot's program (`FORMAT_VERSION` in runtime/src/recording/header.rs).
FORMAT_VERSION = 2
HEADER = "/robot/header"
TICK = "/robot/tick"
DECISION = "/robot/decision"
SNAPSHOT = "/robot/snapshot"
SCAN = "/scan"
IMAGE = "/camera/image"
TRUTH = "/camera/truth_depth"
MAP = "/map"
EVENTS = "/events"
# No chunk that the robot writes is nearly this large; a corrupt length must not exhaust the memory.
MAX_RECORD_BYTES = 256 << 20

# The names of segments, as a regular expression.
SEGMENT_NAME = r"recording_\d{4,}\.mcap"


class BrokenError(Exception):
    """The segment cannot be read any further."""

    def __init__(self, why: str, is_cut: bool = False) -> None:
        super().__init__(why)
        self.is_cut = is_cut
        """Whether only its end is missing: what was read until then is right."""


def segments(path: Path) -> list[Path]:
    """The segments of a run's directory in their order, or the single .mcap file itself."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise TrainerError(f"{path} does not exist; give the --out directory of a run or one .mcap file")
    found = [file for file in path.iterdir() if re.fullmatch(SEGMENT_NAME, file.name)]
    if not found:
        raise TrainerError(f"{path} holds no recording_NNNN.mcap; give the --out directory of a run or one .mcap file")
    return in_order(found)


def in_order(files: list[Path]) -> list[Path]:
    """By length first: segment 10000 comes after segment 9999."""
    return sorted(files, key=lambda file: (len(file.name), file.name))


def messages(
    file: Path, read: Callable[[int], object] | None = None
) -> Iterator[tuple[Schema | None, Channel, Message]]:
    """The messages in file order, each only after the CRC of its chunk was checked. `read` is called with the number of
    bytes that were read since the last call."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    try:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            at = 0
            try:
                reader = StreamReader(stream, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
                for record in reader.records:
                    if read is not None and stream.tell() > at:
                        read(stream.tell() - at)
                        at = stream.tell()
                    if isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel):
                        channels[record.id] = record
                    elif isinstance(record, Message) and record.channel_id in channels:
                        channel = channels[record.channel_id]
                        yield schemas.get(channel.schema_id), channel, record
            except (OSError, TrainerError, BrokenError):
                raise
            except Exception as problem:
                # Corrupt lengths make the reader raise many kinds of exceptions.
                why = f"{type(problem).__name__} {problem}".strip()
                raise BrokenError(why, is_cut=stream.tell() >= size) from problem
    except OSError as problem:
        raise TrainerError(f"cannot read {file}: {problem}; check the file and its permissions") from problem


class Decoder:
    """Decodes the messages whose class comes from the recording's schema."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.factory = DecoderFactory()

    def decode(self, schema: Schema | None, channel: Channel, message: Message) -> Any:  # noqa: ANN401
        decode = self.factory.decoder_for(channel.message_encoding, schema)
        if decode is None:
            raise TrainerError(f"{self.file}: {channel.topic} is not protobuf; use the recording as the robot wrote it")
        return decode(message.data)
