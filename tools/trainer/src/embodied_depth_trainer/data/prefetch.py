"""Prepares the next batch in a thread while the current one is trained on."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

import torch

Item = TypeVar("Item")


class Prefetcher(Generic[Item]):
    """Calls `make` for steps 0, 1, 2, ... one step ahead, in its own thread. `make` must depend on nothing but the
    step, so that jumping back or ahead gives the same result."""

    def __init__(self, make: Callable[[int], Item]) -> None:
        self._make = make
        # One PyTorch thread is enough for this small work; more would spin while they wait for each other.
        self._thread = ThreadPoolExecutor(1, "prefetch", initializer=torch.set_num_threads, initargs=(1,))
        self._ahead: tuple[int, Future[Item]] | None = None
        self.waited_s = 0.0
        """Total time that callers waited for a batch."""

    def __call__(self, step: int) -> Item:
        start = time.perf_counter()
        ahead = self._ahead if self._ahead and self._ahead[0] == step else (step, self._thread.submit(self._make, step))
        item = ahead[1].result()
        self._ahead = step + 1, self._thread.submit(self._make, step + 1)
        self.waited_s += time.perf_counter() - start
        return item
