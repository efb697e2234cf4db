"""Signs recorded segments as the robot does."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, Metadata, SummaryOffset

from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.signature_record import SignatureRecord

MAGIC = b"\x89MCAP0\r\n"
RUN = "5c" * 16
KITCHEN = Ed25519PrivateKey.from_private_bytes(b"k" * 32)
HALL = Ed25519PrivateKey.from_private_bytes(b"h" * 32)
THIEF = Ed25519PrivateKey.from_private_bytes(b"t" * 32)


def public(key: Ed25519PrivateKey) -> str:
    return key.public_key().public_bytes_raw().hex()


ROBOTS = KnownRobots({public(KITCHEN): "kitchen", public(HALL): None})


def bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcodes and bytes of the records of a file."""
    begin = len(MAGIC)
    while begin < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, begin)
        end = begin + 9 + length
        yield opcode, data[begin:end]
        begin = end


def split(data: bytes) -> tuple[bytes, bytes]:
    """The data section of a file, and what follows it: DataEnd, summary and footer."""
    end = len(MAGIC)
    for opcode, found in records(data):
        if opcode == Opcode.DATA_END:
            break
        end += len(found)
    return data[:end], data[end:]


def _moved(opcode: int, record: bytes, by: int) -> bytes:
    """A record behind the signature, whose offsets count the signature. CRCs of 0 are not compared."""
    stream = ReadDataStream(BytesIO(record[9:]))
    if opcode == Opcode.DATA_END:
        return bytes_of(DataEnd(0))
    if opcode == Opcode.SUMMARY_OFFSET:
        offset = SummaryOffset.read(stream)
        return bytes_of(replace(offset, group_start=offset.group_start + by))
    if opcode == Opcode.FOOTER:
        footer = Footer.read(stream)
        return bytes_of(Footer(footer.summary_start + by, footer.summary_offset_start + by, 0))
    return record


def signature_of(
    data: bytes, key: Ed25519PrivateKey, segment: int = 0, previous: str = "", run: str = RUN
) -> SignatureRecord:
    """The signature of a data section."""
    digest = hashlib.sha256(data).hexdigest()
    unsigned = SignatureRecord(public(key), run, str(segment), previous, digest, "")
    return replace(unsigned, signature=key.sign(unsigned.text).hex())


def sign(file: Path, key: Ed25519PrivateKey, previous: str = "", run: str = RUN) -> str:
    """Signs a segment that is complete; returns its digest."""
    before, behind = split(file.read_bytes())
    record = signature_of(before, key, int(file.stem.removeprefix("recording_")), previous, run)
    signature = bytes_of(Metadata("signature", record.__dict__))
    moved = [_moved(opcode, found, len(signature)) for opcode, found in records(MAGIC + behind)]
    file.write_bytes(b"".join([before, signature, *moved, MAGIC]))
    return record.digest


def sign_run(folder: Path, key: Ed25519PrivateKey, run: str = RUN) -> None:
    """Signs all segments of a run, one after the other."""
    previous = ""
    for file in sorted(folder.glob("recording_*.mcap")):
        previous = sign(file, key, previous, run)


def behind_signature(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """The file with something else behind its signature."""
    before, behind = split(data)
    return before + change(behind)
