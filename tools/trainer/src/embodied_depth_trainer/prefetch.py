"""Prepares the next batch while the processor works on this one."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

import torch

Item = TypeVar("Item")


class Prefetcher(Generic[Item]):
    """What `make` gives for step 0, 1, 2, ... made one step ahead by a thread of its own. `make` must depend on nothing
    but the step, so that whoever goes back or ahead gets the same."""

    def __init__(self, make: Callable[[int], Item]) -> None:
        self._make = make
        # Its arithmetic is small, and PyTorch's threads wait for each other by spinning.
        self._thread = ThreadPoolExecutor(1, "prefetch", initializer=torch.set_num_threads, initargs=(1,))
        self._ahead: tuple[int, Future[Item]] | None = None
        self.waited_s = 0.0
        """Time that was spent waiting, in all."""

    def __call__(self, step: int) -> Item:
        start = time.perf_counter()
        ahead = self._ahead if self._ahead and self._ahead[0] == step else (step, self._thread.submit(self._make, step))
        item = ahead[1].result()
        self._ahead = step + 1, self._thread.submit(self._make, step + 1)
        self.waited_s += time.perf_counter() - start
        return item
