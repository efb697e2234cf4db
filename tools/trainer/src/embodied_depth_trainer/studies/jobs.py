"""Runs many loops in parallel from a file with one loop per line.

Finished loops are skipped and interrupted ones continue, so starting the same file again completes the rest.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from tqdm import tqdm

from embodied_depth_trainer.errors import TrainerError

# Number of characters of a failed loop's output that are shown if it holds no error message.
MAX_OUTPUT_SHOWN = 2000


def read_jobs(file: Path) -> list[list[str]]:
    """The arguments of every loop. Empty lines and comments after a # are ignored."""
    try:
        text = file.read_text()
    except OSError as problem:
        raise TrainerError(
            f"cannot read {file}: {problem}; give a file with the arguments of one loop per line"
        ) from None
    lines = [shlex.split(line, comments=True) for line in text.splitlines()]
    jobs = [line for line in lines if line]
    if not jobs:
        raise TrainerError(f"{file} holds no job; write the arguments of one loop on each line")
    return jobs


def run_jobs(jobs: list[list[str]], workers: int) -> None:
    """Runs all jobs, `workers` at a time; a failed job does not stop the others."""
    failed: dict[int, str] = {}
    with ThreadPoolExecutor(workers) as pool, tqdm(total=len(jobs), unit="loop", disable=None) as bar:
        running = {pool.submit(_run, job): number for number, job in enumerate(jobs, 1)}
        for done in as_completed(running):
            number = running[done]
            problem = done.result()
            bar.update()
            outcome = "done" if problem is None else f"failed: {problem}"
            tqdm.write(f"job {number} of {len(jobs)} {outcome}: {shlex.join(jobs[number - 1])}", file=sys.stderr)
            if problem is not None:
                failed[number] = problem
    if failed:
        numbers = ", ".join(map(str, sorted(failed)))
        raise TrainerError(
            f"{len(failed)} of {len(jobs)} jobs failed ({numbers}); start the same file again for the rest"
        )


def _run(job: list[str]) -> str | None:
    """Runs one loop in its own process; returns the error message if it failed."""
    command = [sys.executable, "-m", "embodied_depth_trainer", "loop", *job]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
    if done.returncode == 0:
        return None
    output = done.stderr.decode(errors="replace").strip()
    _, found, problem = output.rpartition("\nerror: ")
    return problem if found else output[-MAX_OUTPUT_SHOWN:] or f"exit {done.returncode}"
