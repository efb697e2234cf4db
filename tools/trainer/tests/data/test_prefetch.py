"""Batches are prepared ahead of the training, and not after it."""

from __future__ import annotations

import threading

from embodied_depth_trainer.data.prefetch import Prefetcher


def test_after_a_stop_nothing_is_made_any_more_and_the_next_call_begins_again() -> None:
    begun = threading.Event()
    may_end = threading.Event()
    made: list[int] = []

    def make(step: int) -> int:
        if step == 1:
            begun.set()
            may_end.wait()
        made.append(step)
        return step

    batches = Prefetcher(make)
    assert batches(0) == 0
    begun.wait()
    threading.Timer(0.05, may_end.set).start()
    batches.stop()
    # The step that was being made is made to its end before the stop returns.
    assert made == [0, 1]
    assert batches(5) == 5
    batches.stop()
