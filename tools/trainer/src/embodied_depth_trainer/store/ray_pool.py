"""Works on many jobs in the processes of a Ray cluster, whose nodes share the folder of the store."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Any

import torch

from embodied_depth_trainer.cluster import joined, result_of
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.shared_folder import check_mark, marked
from embodied_depth_trainer.store.pool import JOBS_FOR_EACH_WORKER, Job, Key, Result

# How often Ray starts a job again whose process or node was lost.
RETRIES = 3


class RayJobs:
    """Computes each job as a task of one CPU. A job is repeated as a whole, so it must write what it makes at once."""

    def __init__(self, on: str, folder: Path) -> None:
        """`folder` is where the jobs write."""
        self.joined = ExitStack()
        with ExitStack() as stack:
            self.ray = stack.enter_context(joined(on))
            self.mark = stack.enter_context(marked(folder))
            self.joined = stack.pop_all()

    def results(self, work: Callable[[Job], Result], jobs: Iterator[tuple[Key, Job]]) -> Iterator[tuple[Key, Result]]:
        """The results with their keys, as they are done."""
        task = self.ray.remote(num_cpus=1, max_retries=RETRIES)(_done)
        running: dict[Any, Key] = {}
        try:
            while True:
                for key, job in islice(jobs, max(0, self._most() - len(running))):
                    running[task.remote(work, job, self.mark)] = key
                if not running:
                    return
                (done,), _ = self.ray.wait(list(running))
                key = running.pop(done)
                yield key, result_of(self.ray, done)
        finally:
            for left in running:
                self.ray.cancel(left)

    def _most(self) -> int:
        """The number of jobs at once; nodes may join and leave meanwhile."""
        return max(1, int(JOBS_FOR_EACH_WORKER * self.ray.cluster_resources().get("CPU", 0)))

    def close(self) -> None:
        self.joined.close()


def _done(work: Callable[[Job], Result], job: Job, mark: Path) -> Result:
    """Does a job on some node; its errors name the node, since a file may be missing on one of them only."""
    torch.set_num_threads(1)
    check_mark(mark)
    try:
        return work(job)
    except TrainerError as problem:
        raise TrainerError(f"node {platform.node()}: {problem}") from None
