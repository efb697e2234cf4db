"""Errors that the user can correct."""

from __future__ import annotations


class TrainerError(Exception):
    """The request cannot be fulfilled. The message names the item, its value and what to do."""
