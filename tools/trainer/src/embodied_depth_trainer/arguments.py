"""Kinds of command line arguments."""

from __future__ import annotations

import argparse


def picture_size(text: str) -> tuple[int, int]:
    """`192x640`: rows x columns, as the papers write it."""
    try:
        height, width = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"`{text}` is not a size such as 192x640 (rows x columns)") from None
    if min(height, width) <= 0:
        raise argparse.ArgumentTypeError(f"`{text}` is empty; rows and columns are above 0")
    return height, width
