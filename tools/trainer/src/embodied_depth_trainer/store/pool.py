"""Works on many jobs, in this process or in several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, TypeVar

import torch
from tqdm import tqdm

from embodied_depth_trainer.cluster import LOCAL
from embodied_depth_trainer.errors import TrainerError

Key = TypeVar("Key")
Job = TypeVar("Job")
Result = TypeVar("Result")
# Jobs that are submitted for each worker: one that is computed and one that waits for it, so that a year of segments is
# not in a queue at once.
JOBS_FOR_EACH_WORKER = 2


class Engine(Protocol):
    """Where jobs are computed."""

    def results(self, work: Callable[[Job], Result], jobs: Iterator[tuple[Key, Job]]) -> Iterator[tuple[Key, Result]]:
        """The results with their keys, as they are done. Jobs are taken as they can be done."""
        ...

    def close(self) -> None: ...


class Pool:
    """An engine that lasts as long as the context."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.engine.close()

    def each(
        self, work: Callable[[Job], Result], jobs: Iterable[tuple[Key, Job]], total: int, name: str
    ) -> Iterator[tuple[Key, Result]]:
        """The results of the jobs with their keys, as they are done. A progress bar shows how many of `total` are."""
        bar = tqdm(total=total, unit=name, disable=None if total else True)
        with bar:
            for done in self.engine.results(work, iter(jobs)):
                yield done
                bar.update()


def pool(on: str, workers: int, folder: Path) -> Pool:
    """The pool that `--on` and `--workers` ask for; its jobs write into the folder."""
    if workers < 1:
        raise TrainerError(f"{workers} workers do nothing; give 1 or more")
    if on != LOCAL:
        # Imported here because it imports this module.
        from embodied_depth_trainer.store.ray_pool import RayJobs

        return Pool(RayJobs(on, folder))
    return Pool(Processes(workers) if workers > 1 else ThisProcess())


class ThisProcess:
    def results(self, work: Callable[[Job], Result], jobs: Iterator[tuple[Key, Job]]) -> Iterator[tuple[Key, Result]]:
        return ((key, work(job)) for key, job in jobs)

    def close(self) -> None:
        pass


class Processes:
    """Several processes on this computer."""

    def __init__(self, workers: int) -> None:
        # A fork of a process with PyTorch's threads can block.
        self.most = JOBS_FOR_EACH_WORKER * workers
        spawn = multiprocessing.get_context("spawn")
        self.processes = ProcessPoolExecutor(workers, spawn, torch.set_num_threads, (1,))

    def results(self, work: Callable[[Job], Result], jobs: Iterator[tuple[Key, Job]]) -> Iterator[tuple[Key, Result]]:
        running: dict[Future[Result], Key] = {}
        try:
            while True:
                for key, job in islice(jobs, self.most - len(running)):
                    running[self.processes.submit(work, job)] = key
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        except BrokenProcessPool:
            raise TrainerError(
                "a worker was killed, perhaps for lack of memory; what is done is kept: run the same command again, "
                "with fewer --workers"
            ) from None

    def close(self) -> None:
        self.processes.shutdown(cancel_futures=True)
