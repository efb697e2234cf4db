"""Works on many jobs, in this process or in several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from types import TracebackType
from typing import Self, TypeVar

import torch
from tqdm import tqdm

from embodied_depth_trainer.errors import TrainerError

Key = TypeVar("Key")
Job = TypeVar("Job")
Result = TypeVar("Result")


class Pool:
    """Processes that last as long as the context. One worker is this process itself."""

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise TrainerError(f"{workers} workers do nothing; give 1 or more")
        # A fork of a process with PyTorch's threads can block.
        spawn = multiprocessing.get_context("spawn")
        self.processes = ProcessPoolExecutor(workers, spawn, torch.set_num_threads, (1,)) if workers > 1 else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.processes is not None:
            self.processes.shutdown(cancel_futures=True)

    def each(self, work: Callable[[Job], Result], jobs: Mapping[Key, Job], name: str) -> Iterator[tuple[Key, Result]]:
        """The results of the jobs with their keys, as they are done. A progress bar shows how many are."""
        bar = tqdm(total=len(jobs), unit=name, disable=None if jobs else True)
        with bar:
            for done in self._results(work, jobs):
                yield done
                bar.update()

    def _results(self, work: Callable[[Job], Result], jobs: Mapping[Key, Job]) -> Iterator[tuple[Key, Result]]:
        if self.processes is None:
            yield from ((key, work(job)) for key, job in jobs.items())
            return
        futures = {self.processes.submit(work, job): key for key, job in jobs.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise TrainerError(
                "a worker was killed, perhaps for lack of memory; what is done is kept: run the same command again, "
                "with fewer --workers"
            ) from None
