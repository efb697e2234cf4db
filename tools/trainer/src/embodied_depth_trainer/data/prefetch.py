"""Prepares the next batches in threads while the current one is trained on."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Generic, TypeVar

import torch

Item = TypeVar("Item")


class Prefetcher(Generic[Item]):
    """Calls `make` for steps 0, 1, 2, ..., as many steps ahead as there are `readers`, each in its own thread. `make`
    must depend on nothing but the step, so that jumping back or ahead, and any number of readers, gives the same
    result."""

    def __init__(self, make: Callable[[int], Item], readers: int = 1) -> None:
        self._make = make
        self._readers = readers
        # One PyTorch thread is enough for this small work; more would spin while they wait for each other.
        self._threads = ThreadPoolExecutor(readers, "prefetch", initializer=torch.set_num_threads, initargs=(1,))
        self._ahead: dict[int, Future[Item]] = {}
        self.waited_s = 0.0
        """Total time that callers waited for a batch."""

    def __call__(self, step: int) -> Item:
        start = time.perf_counter()
        # After a jump, the batches of other steps are not needed.
        kept = {ahead: future for ahead, future in self._ahead.items() if step <= ahead <= step + self._readers}
        found = kept.pop(step, None) or self._threads.submit(self._make, step)
        item = found.result()
        for ahead in range(step + 1, step + 1 + self._readers):
            if ahead not in kept:
                kept[ahead] = self._threads.submit(self._make, ahead)
        self._ahead = kept
        self.waited_s += time.perf_counter() - start
        return item

    def stop(self) -> None:
        """Gives up the steps ahead, and waits for those that are already being made: nothing is read after it. The next
        call begins again."""
        running = [future for future in self._ahead.values() if not future.cancel()]
        wait(running)
        self._ahead = {}
