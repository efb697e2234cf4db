"""A segment is accepted only if a known robot signed all of it that a reader reads."""

from __future__ import annotations

import struct
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader

from embodied_depth_trainer.data.recording import read_segment
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.store.known_robots import read_robots
from embodied_depth_trainer.store.signature import check
from embodied_depth_trainer.store.signature_record import UntrustedError

from ..rooms import room
from ..signing import (
    HALL,
    KITCHEN,
    MAGIC,
    ROBOTS,
    RUN,
    THIEF,
    behind_signature,
    bytes_of,
    public,
    sign,
    signature_of,
    split,
)
from ..stores import record

MESSAGE = Message(1, 0, b"{}", 0, 0)


@pytest.fixture
def segment(tmp_path: Path) -> Path:
    """Segment 3 of a run, unsigned."""
    record(tmp_path, room(8, (16, 32)), [2, 2, 2, 2], range(3, 4))
    return tmp_path / "recording_0003.mcap"


def refusal(file: Path) -> str:
    with pytest.raises(UntrustedError) as problem:
        check(file, ROBOTS)
    return str(problem.value)


def test_a_segment_of_a_known_robot_is_accepted_and_read_as_without_its_signature(segment: Path) -> None:
    before = read_segment(segment)
    digest = sign(segment, KITCHEN, "ab" * 32)
    found = check(segment, ROBOTS)
    assert (found.robot, found.run, found.segment) == (public(KITCHEN), RUN, "3")
    assert (found.previous, found.digest) == ("ab" * 32, digest)
    after = read_segment(segment)
    assert after.damage is None
    assert np.array_equal(after.frames.rgb, before.frames.rgb)
    with segment.open("rb") as stream:
        assert make_reader(stream).get_summary() is not None


def test_the_signed_text_is_that_of_the_robot() -> None:
    found = signature_of(b"", KITCHEN)
    assert found.text.decode() == (
        f"embodied-depth segment 1\nrobot {public(KITCHEN)}\nrun {RUN}\nsegment 0\nprevious \n"
        "digest e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855\n"
    )


def test_an_unsigned_segment_and_other_files_are_refused(segment: Path) -> None:
    assert refusal(segment) == "unsigned"
    segment.write_bytes(b"not a recording")
    assert refusal(segment) == "unsigned"
    segment.write_bytes(b"")
    assert refusal(segment) == "unsigned"


def test_an_unknown_robot_is_named_by_its_key(segment: Path) -> None:
    sign(segment, THIEF)
    assert refusal(segment) == f"signed by an unknown robot {public(THIEF)[:8]}..."


def test_the_key_of_a_known_robot_does_not_help_another_one(segment: Path) -> None:
    sign(segment, THIEF)
    forged = segment.read_bytes().replace(public(THIEF).encode(), public(KITCHEN).encode())
    segment.write_bytes(forged)
    assert refusal(segment) == "changed since it was signed"


def test_every_changed_byte_up_to_the_end_of_the_signature_is_noticed(segment: Path) -> None:
    sign(segment, KITCHEN)
    signed = segment.read_bytes()
    end = len(split(signed)[0])
    found = set()
    for place in [*range(0, end, 97), *range(end - 900, end, 7)]:
        changed = bytearray(signed)
        changed[place] ^= 1
        segment.write_bytes(changed)
        found.add(refusal(segment))
    assert "changed since it was signed" in found


def test_a_segment_that_is_cut_is_refused_wherever_it_ends(segment: Path) -> None:
    sign(segment, KITCHEN)
    signed = segment.read_bytes()
    for length in [*range(0, len(signed), 211), *range(len(signed) - 60, len(signed))]:
        segment.write_bytes(signed[:length])
        assert refusal(segment) == "unsigned"


def test_a_segment_under_another_name_is_refused(segment: Path) -> None:
    sign(segment, KITCHEN)
    for name in ("recording_0002.mcap", "recording_00003.mcap", "recording_0003.mcap.1"):
        segment = segment.rename(segment.with_name(name))
        assert refusal(segment) == "is segment 3 under another name"


@pytest.mark.parametrize(
    "added",
    [
        Chunk("", bytes_of(MESSAGE), 0, 0, 0, len(bytes_of(MESSAGE))),
        MESSAGE,
        MessageIndex(1, [(0, 0)]),
        Attachment(0, 0, "name", "text/plain", b"data"),
        Metadata("name", {}),
    ],
    ids=lambda added: type(added).__name__,
)
def test_data_behind_the_signature_are_refused(segment: Path, added: McapRecord) -> None:
    sign(segment, KITCHEN)
    signed = segment.read_bytes()
    end = bytes_of(DataEnd(0))
    segment.write_bytes(behind_signature(signed, lambda behind: bytes_of(added) + behind))
    assert refusal(segment) == "data behind the signature"
    segment.write_bytes(behind_signature(signed, lambda behind: end + bytes_of(added) + behind.removeprefix(end)))
    assert refusal(segment) == "data behind the signature"


def test_schemas_and_channels_may_follow_only_in_the_summary(segment: Path) -> None:
    sign(segment, KITCHEN)
    signed = segment.read_bytes()
    end = bytes_of(DataEnd(0))
    added = bytes_of(Schema(9, b"", "", "name")) + bytes_of(Channel(9, "/topic", "json", {}, 9))
    segment.write_bytes(behind_signature(signed, lambda behind: end + added + behind.removeprefix(end)))
    assert check(segment, ROBOTS).robot == public(KITCHEN)
    segment.write_bytes(behind_signature(signed, lambda behind: added + behind))
    assert refusal(segment) == "data behind the signature"


def test_bytes_behind_the_end_are_refused(segment: Path) -> None:
    sign(segment, KITCHEN)
    segment.write_bytes(segment.read_bytes() + b"\0")
    assert refusal(segment) == "data behind the signature"


def test_records_of_unknown_kinds_and_large_ones_behind_the_signature_are_refused(segment: Path) -> None:
    sign(segment, KITCHEN)
    signed = segment.read_bytes()
    end = bytes_of(DataEnd(0))
    for opcode, body in ((0x80, b"x"), (Opcode.SCHEMA, bytes(2 << 20))):
        added = struct.pack("<BQ", opcode, len(body)) + body
        before, behind = split(signed)
        segment.write_bytes(before + end + added + behind.removeprefix(end))
        assert refusal(segment) == "data behind the signature"


def test_a_message_that_a_wrong_length_hides_in_the_summary_is_refused(segment: Path) -> None:
    """mcap's reader goes by the length of the schema's content, which leads it into the next record."""
    sign(segment, KITCHEN)
    hidden = bytes_of(Message(1, 0, b"hidden", 0, 0))
    schema = bytearray(bytes_of(Schema(9, b"", "", "")))
    # The content takes in the opcode and the length of the record behind it.
    schema[-4:] = struct.pack("<I", 9)
    statistics = struct.pack("<BQ", Opcode.STATISTICS, len(hidden)) + hidden
    end = bytes_of(DataEnd(0))
    added = end + bytes(schema) + statistics
    segment.write_bytes(behind_signature(segment.read_bytes(), lambda behind: added + behind.removeprefix(end)))
    with segment.open("rb") as stream:
        assert any(isinstance(found, Message) and found.data == b"hidden" for found in StreamReader(stream).records)
    assert refusal(segment) == "data behind the signature"


@pytest.mark.parametrize("change", ["missing", "added", "twice", "upper case", "behind the map"])
def test_a_signature_that_no_robot_writes_is_refused(segment: Path, change: str) -> None:
    before, behind = split(segment.read_bytes())
    entries = list(signature_of(before, KITCHEN, 3).__dict__.items())
    if change == "missing":
        entries.pop()
    elif change == "added":
        entries.append(("name", "kitchen"))
    elif change == "twice":
        entries.append(entries[0])
    elif change == "upper case":
        entries[-1] = (entries[-1][0], entries[-1][1].upper())
    pairs = b"".join(struct.pack("<I", len(text)) + text.encode() for pair in entries for text in pair)
    body = struct.pack("<I", 9) + b"signature" + struct.pack("<I", len(pairs)) + pairs
    body += b"\0" if change == "behind the map" else b""
    record = struct.pack("<BQ", Opcode.METADATA, len(body)) + body
    segment.write_bytes(before + record + behind)
    assert refusal(segment) == "changed since it was signed"


def test_other_metadata_before_the_signature_are_data(segment: Path) -> None:
    before, behind = split(segment.read_bytes())
    segment.write_bytes(before + bytes_of(Metadata("name", {"key": "value"})) + behind)
    sign(segment, HALL)
    assert check(segment, ROBOTS).robot == public(HALL)


def test_the_memory_that_a_check_takes_does_not_grow_with_the_segment(tmp_path: Path) -> None:
    file = tmp_path / "recording_0000.mcap"
    large = struct.pack("<BQ", Opcode.ATTACHMENT, 64 << 20) + bytes(64 << 20)
    file.write_bytes(MAGIC + large + bytes_of(DataEnd(0)) + struct.pack("<BQ", Opcode.FOOTER, 20) + bytes(20) + MAGIC)
    sign(file, KITCHEN)
    tracemalloc.start()
    check(file, ROBOTS)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 8 << 20


def test_a_missing_package_is_named(segment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sign(segment, KITCHEN)
    monkeypatch.setitem(sys.modules, "cryptography.exceptions", None)
    with pytest.raises(TrainerError, match="pip install cryptography"):
        check(segment, ROBOTS)


def test_known_robots_are_read_with_and_without_names(tmp_path: Path) -> None:
    file = tmp_path / "robots.txt"
    file.write_text(f"# our robots\n\n{public(KITCHEN)} kitchen\n  {public(HALL)}\n")
    robots = read_robots(file)
    assert robots.names == {public(KITCHEN): "kitchen", public(HALL): None}
    assert [robots.label(public(key)) for key in (KITCHEN, HALL)] == ["kitchen", f"{public(HALL)[:8]}..."]
    # The digest is one of the keys.
    assert robots.digest == ROBOTS.digest
    file.write_text(public(KITCHEN))
    assert read_robots(file).digest != ROBOTS.digest


@pytest.mark.parametrize("line", ["kitchen", "abcd kitchen", f"{'a' * 64} the kitchen", f"{'a' * 65}", "A" * 64])
def test_a_line_that_is_no_robot_is_named_with_its_number(tmp_path: Path, line: str) -> None:
    file = tmp_path / "robots.txt"
    file.write_text(f"# comment\n{public(KITCHEN)}\n{line}\n")
    with pytest.raises(
        TrainerError, match=rf"robots.txt, line 3: `{line}` is no robot; expected are the 64 lower-case hex digits"
    ):
        read_robots(file)


def test_a_file_without_a_robot_and_one_that_does_not_exist_are_named(tmp_path: Path) -> None:
    file = tmp_path / "robots.txt"
    with pytest.raises(TrainerError, match=r"cannot read .*robots\.txt.*--robots FILE"):
        read_robots(file)
    file.write_text("# none\n")
    with pytest.raises(TrainerError, match=r"robots\.txt names no robot"):
        read_robots(file)


def test_what_the_robots_program_signed_is_accepted_and_with_one_bit_changed_it_is_not(tmp_path: Path) -> None:
    """`firmware-host run` recorded the segment, and `firmware-host identity` printed the robot."""
    folder = Path(__file__).parent / "signed_by_a_robot"
    segment = folder / "recording_0000.mcap"
    robots = read_robots(folder / "robots")
    assert check(segment, robots).segment == "0"
    changed = bytearray(segment.read_bytes())
    changed[len(changed) // 4] ^= 1
    copy = tmp_path / segment.name
    copy.write_bytes(changed)
    with pytest.raises(UntrustedError):
        check(copy, robots)
