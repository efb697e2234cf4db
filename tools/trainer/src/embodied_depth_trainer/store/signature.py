"""Checks who signed a segment: the digest of its bytes, and that nothing which a reader would read follows.

The file's records are walked here, and not by a library, because the digest is one of bytes. Memory is bounded.
"""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.known_robots import KnownRobots, shortened
from embodied_depth_trainer.store.signature_record import (
    BEHIND,
    CHANGED,
    MOST_BYTES,
    UNSIGNED,
    SignatureRecord,
    UntrustedError,
    signature_in,
)

MAGIC = b"\x89MCAP0\r\n"
# Opcode and length of a record.
HEAD = struct.Struct("<BQ")
# What is read at once, and more than any record behind the signature has.
PIECE = 1 << 20
# How the reader of the trainings reads the records that may follow DataEnd.
SUMMARY: dict[int, Callable[[ReadDataStream], object]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.SUMMARY_OFFSET: SummaryOffset.read,
    Opcode.FOOTER: Footer.read,
}


def check(file: Path, robots: KnownRobots) -> SignatureRecord:
    """The signature of a segment that a known robot signed and that is as it was; raises `UntrustedError` if it is
    not."""
    with file.open("rb") as stream:
        records = _Records(stream)
        record, digest = _signed_part(records)
        _check_behind(records)
    if record.robot not in robots.names:
        raise UntrustedError(unknown(record.robot))
    if record.digest != digest or not _is_signed(record):
        raise UntrustedError(CHANGED)
    if file.name != record.file_name:
        raise UntrustedError(f"is segment {record.segment} under another name")
    return record


def unknown(robot: str) -> str:
    """What is said of the segments of an unknown robot."""
    return f"signed by an unknown robot {shortened(robot)}"


class _Records:
    """The records of a file. One that reaches beyond the end of the file was cut, and a robot signs none that was."""

    def __init__(self, stream: BinaryIO) -> None:
        self.stream = stream
        self.left = os.fstat(stream.fileno()).st_size

    def head(self) -> tuple[int, int, bytes]:
        """Opcode and length of the next record, and the bytes that they were read from."""
        data = self.read(HEAD.size)
        opcode, length = HEAD.unpack(data)
        if length > self.left:
            raise UntrustedError(UNSIGNED)
        return opcode, length, data

    def read(self, length: int) -> bytes:
        data = self.stream.read(length) if length <= self.left else b""
        if len(data) != length:
            raise UntrustedError(UNSIGNED)
        self.left -= length
        return data


def _signed_part(records: _Records) -> tuple[SignatureRecord, str]:
    """The signature, and the digest of what is before it."""
    magic = records.read(len(MAGIC))
    if magic != MAGIC:
        raise UntrustedError(UNSIGNED)
    digest = hashlib.sha256(magic)
    while True:
        opcode, length, head = records.head()
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            raise UntrustedError(UNSIGNED)
        first = records.read(min(length, PIECE))
        found = signature_in(first) if opcode == Opcode.METADATA and length <= MOST_BYTES else None
        if found is not None:
            return found, digest.hexdigest()
        digest.update(head)
        digest.update(first)
        for begin in range(PIECE, length, PIECE):
            digest.update(records.read(min(PIECE, length - begin)))


def _check_behind(records: _Records) -> None:
    """Refuses records behind the signature that are not those of the end of a file."""
    _expect(records, {Opcode.DATA_END: DataEnd.read})
    opcode = 0
    while opcode != Opcode.FOOTER:
        opcode = _expect(records, SUMMARY)
    if records.read(len(MAGIC)) != MAGIC or records.left:
        raise UntrustedError(BEHIND)


def _expect(records: _Records, readers: dict[int, Callable[[ReadDataStream], object]]) -> int:
    """Reads the next record, which must be one of these; returns its opcode."""
    opcode, length, _ = records.head()
    if opcode not in readers or length > PIECE or not _is_whole(readers[opcode], records.read(length)):
        raise UntrustedError(BEHIND)
    return opcode


def _is_whole(read: Callable[[ReadDataStream], object], body: bytes) -> bool:
    """Whether a record ends where its length says. The reader of the trainings goes by the lengths of the texts in a
    record instead: if these were longer, it would go on to read inside of a later record."""
    stream = ReadDataStream(BytesIO(body + b"\0"))
    try:
        read(stream)
    except Exception:
        # Wrong lengths make the reader raise many kinds of exceptions.
        return False
    return stream.count == len(body)


def _is_signed(record: SignatureRecord) -> bool:
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    except ImportError:
        raise TrainerError(
            "signatures are checked by the package cryptography; run `pip install cryptography`"
        ) from None
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(record.robot))
        key.verify(bytes.fromhex(record.signature), record.text)
    except (InvalidSignature, ValueError):
        return False
    return True
