"""What a user is told: the thing, the value, the way out."""

from __future__ import annotations


class TrainerError(Exception):
    """The wish cannot be fulfilled; the text says why and what to do."""
