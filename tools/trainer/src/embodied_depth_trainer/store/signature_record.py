"""The record that a robot writes at the end of a segment to sign it: MCAP metadata named `signature`."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, fields

from embodied_depth_trainer.errors import TrainerError

# A signature has 600 bytes. Longer metadata are data as any other.
MOST_BYTES = 4096
SIZE = struct.Struct("<I")
NAME = SIZE.pack(len(b"signature")) + b"signature"


class UntrustedError(TrainerError):
    """No known robot signed the segment as it is. The message says why."""


# What `UntrustedError` says, besides whose signature it is.
UNSIGNED = "unsigned"
CHANGED = "changed since it was signed"
BEHIND = "data behind the signature"


@dataclass(frozen=True)
class SignatureRecord:
    """The entries of the record."""

    robot: str
    """Ed25519 public key of the robot."""
    run: str
    """Identity of the run."""
    segment: str
    """Number of the segment in its run."""
    previous: str
    """`digest` of the signed segment before it in this run; empty for the first."""
    digest: str
    """SHA-256 of all bytes of the file before the record."""
    signature: str
    """Ed25519 signature of `text`."""

    @property
    def text(self) -> bytes:
        """What is signed."""
        return (
            f"embodied-depth segment 1\nrobot {self.robot}\nrun {self.run}\nsegment {self.segment}\n"
            f"previous {self.previous}\ndigest {self.digest}\n"
        ).encode()

    @property
    def file_name(self) -> str:
        """The name that the robot gave to the segment's file."""
        return f"recording_{int(self.segment):04d}.mcap"


# The form of each entry.
FORMS = {
    "robot": "[0-9a-f]{64}",
    "run": "[0-9a-f]{32}",
    "segment": "0|[1-9][0-9]{0,8}",
    "previous": "(?:[0-9a-f]{64})?",
    "digest": "[0-9a-f]{64}",
    "signature": "[0-9a-f]{128}",
}
assert list(FORMS) == [field.name for field in fields(SignatureRecord)]


def signature_in(body: bytes) -> SignatureRecord | None:
    """The signature in the body of a metadata record; `None` if these are other metadata. The record itself is not
    signed, so it is refused unless it is exactly what a robot writes."""
    if not body.startswith(NAME):
        return None
    try:
        pairs = _pairs(body[len(NAME) :])
    except (struct.error, ValueError):
        raise UntrustedError(CHANGED) from None
    entries = dict(pairs)
    is_whole = len(pairs) == len(FORMS) and entries.keys() == FORMS.keys()
    if not is_whole or not all(re.fullmatch(form, entries[key]) for key, form in FORMS.items()):
        raise UntrustedError(CHANGED)
    return SignatureRecord(**entries)


def _pairs(data: bytes) -> list[tuple[str, str]]:
    """Keys and values of a map, which fills the data."""
    text, rest = _text(data)
    if rest:
        raise ValueError(f"{len(rest)} bytes behind the map")
    found = []
    while text:
        key, text = _text(text)
        value, text = _text(text)
        found.append((key.decode(), value.decode()))
    return found


def _text(data: bytes) -> tuple[bytes, bytes]:
    """The text at the beginning, which follows its length, and the rest."""
    (size,) = SIZE.unpack_from(data)
    end = SIZE.size + size
    if end > len(data):
        raise ValueError(f"a text of {size} bytes in {len(data)}")
    return data[SIZE.size : end], data[end:]
