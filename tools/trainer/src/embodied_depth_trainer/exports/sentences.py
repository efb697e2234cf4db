"""What happened in a tick, in the robot's own sentences.

The recording holds them on `/events`, with one exception: of ticks in a row without depth, for the same reason, only
the first has a message, and the tick in which depth is back has one more (`runtime/src/recording/event_log.rs`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

# Levels of diagnostic_msgs/DiagnosticStatus.
OK, WARN, ERROR = 0, 1, 2
# By the levels of foxglove.Log.
_LEVELS = {3: WARN, 4: ERROR, 5: ERROR}

# Why the robot does not know where it is (`lost_reason` in runtime/src/recording/sentences.rs). Only the tick in which
# it became lost has a message on `/events`.
LOST = {
    "scan_does_not_fit": "scans do not fit what was seen a moment ago",
    "carried": "scans changed while the wheels stood: the robot was carried",
    "loaded": "the robot was started in a saved map",
}


@dataclass(frozen=True)
class Sentence:
    """A line of the robot's log."""

    level: int
    text: str

    @staticmethod
    def logged(level: int, text: str) -> Sentence:
        """From the level of `foxglove.Log`."""
        return Sentence(_LEVELS.get(level, OK), text)


class Sentences:
    """The sentences of consecutive ticks of a segment."""

    def __init__(self) -> None:
        self._no_depth: tuple[str, Sentence] | None = None

    def of(self, events: Iterable[dict[str, Any]], logged: Iterable[Sentence]) -> list[Sentence]:
        """A sentence for each event of a decision; `logged` is what the recording holds for the same tick."""
        before, self._no_depth = self._no_depth, None
        rest = iter(logged)
        return [self._sentence(event, before, rest) for event in events]

    def _sentence(
        self, event: dict[str, Any], before: tuple[str, Sentence] | None, rest: Iterator[Sentence]
    ) -> Sentence:
        if event["event"] != "no_depth":
            return _next(event, rest)
        why = event["why"]
        sentence = before[1] if before is not None and before[0] == why else _next(event, rest)
        self._no_depth = (why, sentence)
        return sentence


def _next(event: dict[str, Any], rest: Iterator[Sentence]) -> Sentence:
    # A tool may have filtered the channel out.
    return next(rest, Sentence(OK, event["event"].replace("_", " ")))
