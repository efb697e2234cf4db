"""Many loops side by side: a file with one loop a line, and a pool of processes that works it off.

A loop that is done is not done again, and one that was cut off goes on: starting the same file again finishes the rest.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from tqdm import tqdm

from .errors import TrainerError

# Characters of what a loop said that failed without saying why.
LONGEST_COMPLAINT = 2000


def read_jobs(file: Path) -> list[list[str]]:
    """The arguments of every loop. Empty lines and what follows a # do not count."""
    try:
        text = file.read_text()
    except OSError as problem:
        raise TrainerError(
            f"cannot read {file}: {problem}; give a file with the arguments of one loop a line"
        ) from None
    lines = [shlex.split(line, comments=True) for line in text.splitlines()]
    jobs = [line for line in lines if line]
    if not jobs:
        raise TrainerError(f"{file} holds no job; write the arguments of one loop on each line")
    return jobs


def run_jobs(jobs: list[list[str]], workers: int) -> None:
    """Runs all of them, `workers` at a time; one that fails does not stop the others."""
    failed: dict[int, str] = {}
    with ThreadPoolExecutor(workers) as pool, tqdm(total=len(jobs), unit="loop", disable=None) as bar:
        running = {pool.submit(_run, job): number for number, job in enumerate(jobs, 1)}
        for done in as_completed(running):
            number = running[done]
            problem = done.result()
            bar.update()
            said = "done" if problem is None else f"failed: {problem}"
            tqdm.write(f"job {number} of {len(jobs)} {said}: {shlex.join(jobs[number - 1])}", file=sys.stderr)
            if problem is not None:
                failed[number] = problem
    if failed:
        numbers = ", ".join(map(str, sorted(failed)))
        raise TrainerError(
            f"{len(failed)} of {len(jobs)} jobs failed ({numbers}); start the same file again for the rest"
        )


def _run(job: list[str]) -> str | None:
    """Runs one loop in a process of its own; what it complains of, if it failed."""
    command = [sys.executable, "-m", "embodied_depth_trainer.cli", "loop", *job]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
    if done.returncode == 0:
        return None
    said = done.stderr.decode(errors="replace").strip()
    _, found, problem = said.rpartition("\nerror: ")
    return problem if found else said[-LONGEST_COMPLAINT:] or f"exit {done.returncode}"
